"""How texels are stored on a device: kinds by type and channels, and their copy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from .textures import Texels

_ALIGNMENT = 8  # alignment of addresses [bytes]: texels are loaded whole, up to this many bytes at a time

TEXEL_KINDS = {
    ("uint8", 1): (Texels.BYTE, wp.uint8),
    ("uint8", 3): (Texels.BYTE3, wp.uint8),
    ("uint8", 4): (Texels.BYTE4, wp.vec4ub),
    ("float16", 1): (Texels.HALF, wp.float16),
    ("float16", 4): (Texels.HALF4, wp.vec4h),
    ("float32", 1): (Texels.FLOAT, wp.float32),
    ("float32", 4): (Texels.FLOAT4, wp.vec4),
}


@dataclass(frozen=True)
class Part:
    """A picture or a level of it, as its entry in the table of images has it (`ImageEntry`)."""

    address: int
    texels: int
    width: int  # [texels]
    height: int


def uploaded_texels(pixels: np.ndarray, dtype: type, device) -> wp.array:
    """Texels [..., 1 or 4] one after another on the device."""
    flat = np.ascontiguousarray(pixels).reshape((-1, 4) if pixels.shape[-1] == 4 else -1)
    if flat.ctypes.data % _ALIGNMENT:
        flat = flat.copy()
    # on the CPU this is the memory of the pixels itself, which `keep` holds
    return wp.array(flat, dtype=dtype, device=device, copy=device.is_cuda)


def finite_texels(pixels: np.ndarray) -> tuple[np.ndarray, int]:
    """`pixels` with every texel black that has a channel that is not finite, and the number of these texels."""
    good = np.isfinite(pixels).all(2)
    bad = good.size - int(np.count_nonzero(good))
    if not bad:
        return pixels, 0
    own = pixels.copy()
    own[~good] = 0
    return own, bad


def with_alpha(pixels: np.ndarray) -> np.ndarray:
    """`pixels` [height, width, 3] with an opaque fourth channel."""
    opaque = 255 if pixels.dtype == np.uint8 else 1
    return np.concatenate([pixels, np.full((*pixels.shape[:2], 1), opaque, pixels.dtype)], 2)
