"""The random numbers of objects and of their instances, which shader graphs read."""

from __future__ import annotations

import functools

import bpy
import numpy as np

from ..lookup3 import lookup3

_RANDOM_MOST = 2**32 - 1  # largest random number of an object


@functools.lru_cache(maxsize=1 << 16)
def _random_id(name: str) -> int:
    """The random number of an object that is no instance, as Cycles draws it from the name.

    It is a hash of 32 bits, hashed by lookup3.
    """
    code = 0
    for byte in name.encode():
        code = (code * 37 + (byte if byte < 128 else byte - 256)) & 0xFFFFFFFF
    return int(lookup3(np.array([code], np.uint32), words=2)[0])


def random_of(placed: bpy.types.DepsgraphObjectInstance) -> float:
    """The random number of a placed object, 0..1."""
    # Blender gives the 32 bits with a sign
    return (placed.random_id & _RANDOM_MOST if placed.is_instance else _random_id(placed.object.name)) / _RANDOM_MOST
