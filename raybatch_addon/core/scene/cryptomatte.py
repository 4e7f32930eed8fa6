"""Identities of Cryptomatte: hashes of names as numbers of the exponent range that pictures keep.

Friedman and Jones, "Cryptomatte specification", version 1.2.0: MurmurHash3 of 32 bits with seed 0 of the name in
UTF-8, made a finite float32 by its exponent.
"""

from __future__ import annotations

import json
import struct

from .description import Scene
from .passes import matte_kinds

_MASK = 0xFFFFFFFF


def _rotated(x: int, bits: int) -> int:
    return (x << bits | x >> (32 - bits)) & _MASK


def _scrambled(k: int) -> int:
    return _rotated(k * 0xCC9E2D51 & _MASK, 15) * 0x1B873593 & _MASK


def murmur_hash(name: str) -> int:
    """MurmurHash3_x86_32 of `name` with seed 0 (Appleby 2011)."""
    data = name.encode()
    whole = len(data) // 4 * 4
    h = 0
    for (k,) in struct.iter_unpack("<I", data[:whole]):
        h = (_rotated(h ^ _scrambled(k), 13) * 5 + 0xE6546B64) & _MASK
    if tail := data[whole:]:
        h ^= _scrambled(int.from_bytes(tail, "little"))
    h ^= len(data)
    h = (h ^ h >> 16) * 0x85EBCA6B & _MASK
    h = (h ^ h >> 13) * 0xC2B2AE35 & _MASK
    return h ^ h >> 16


def matte_identity(name: str) -> int:
    """Bits of the float32 that stands for `name`: the hash, with exponents of 0 and 255 replaced by 1 and 254."""
    value = murmur_hash(name)
    exponent = min(max(value >> 23 & 0xFF, 1), 254)
    return value & 0x807FFFFF | exponent << 23


def matte_fields(layer: str, scene: Scene) -> dict[str, str]:
    """Metadata of files that hold the mattes of `scene`, by which other programs find objects; `layer` comes before
    the passes' names there.
    """
    names = {
        "CryptoObject": scene.object_names,
        "CryptoMaterial": [material.name for material in scene.materials],
        "CryptoAsset": scene.asset_names,
    }
    fields: dict[str, str] = {}
    for kind in matte_kinds(scene.frame.passes):
        name = f"{layer}.{kind}" if layer else kind
        manifest = {each: f"{murmur_hash(each):08x}" for each in names[kind]}
        of_kind = {
            "name": name,
            "hash": "MurmurHash3_32",
            "conversion": "uint32_to_float32",
            "manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
        }
        fields |= {f"cryptomatte/{f'{murmur_hash(name):08x}'[:7]}/{key}": value for key, value in of_kind.items()}
    return fields
