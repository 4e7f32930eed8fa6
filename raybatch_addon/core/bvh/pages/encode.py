"""Triangles of QUANTISED packed for stores and copies: about 15 bytes instead of 48, expanded on the device to the same
bits.

The triangles of a page lie in the order of leaves, so that neighbours share vertices. A *block* is a run of them with
at most 256 vertices, each listed once. Words of 32 bits:

    header      triangles; bits of a triangle's index in its block; whether faces are wide; first word of each part
                that follows
    table       by block: its first vertex, its lowest face
    corners     by triangle: the indices of its three vertices in the block's list (8 bits each), the lowest 8 bits of
                its face above the lowest
    faces       by triangle: the other bits, 16, or 32 where these do not suffice somewhere in the page
    vertices    float32, three each
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ..node import QUANTISED_TRIANGLE

HEADER_WORDS = 8
# Triangles of a block by the bits of their indices: 128 have no more than 256 vertices in most meshes, 64 have so in
# all
BLOCK_BITS = (7, 6)
BLOCK_VERTICES_MAX = 256
_VECTORS = 3  # of a triangle


def encode_triangles(triangles: np.ndarray, corners: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """The packed words, uint32.

    Args:
        triangles: words of a QUANTISED tree, float32 [n, 12].
        corners: vertices of each of them, int32 [n, 3]: indices into `positions`, of which the triangles are made.
        positions: float32 [v, 3].
    """
    count = len(triangles)
    faces = np.ascontiguousarray(triangles).view(QUANTISED_TRIANGLE)[:, 0]["face"]
    for bits in BLOCK_BITS:
        indices, vertices, vertex_first = _blocks(corners, bits)
        if count == 0 or np.diff(vertex_first).max() <= BLOCK_VERTICES_MAX:
            break
    starts = np.arange(0, count, 1 << bits)
    face_first = np.minimum.reduceat(faces, starts) if count else np.zeros(0, np.int32)
    above = (faces - np.repeat(face_first, 1 << bits)[:count]).view(np.uint32)
    wide = bool(count) and int(above.max()) >= 1 << 24
    high = (above >> 8).astype(np.uint32 if wide else np.uint16)
    if not wide and count % 2:
        high = np.append(high, np.uint16(0))
    indices = indices.astype(np.uint32)
    parts = [
        np.stack([vertex_first[:-1], face_first], 1).astype(np.uint32),
        indices[:, 0] | indices[:, 1] << 8 | indices[:, 2] << 16 | (above & 255) << 24,
        high.view(np.uint32),
        positions.take(vertices, axis=0).view(np.uint32),
    ]
    ends = HEADER_WORDS + np.cumsum([0, *(part.size for part in parts)])
    header = np.zeros(HEADER_WORDS, np.uint32)
    header[:7] = count, bits, wide, *ends[:4]
    return np.concatenate([header, *(part.reshape(-1) for part in parts)])


def _blocks(corners: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of corners among the vertices of their block, [n, 3]; the vertices of all blocks; where those of each
    begin.
    """
    width = 3 << bits
    block_count = -(-corners.size // width)
    keys = np.empty(block_count * width, np.int64)
    keys[: corners.size] = corners.reshape(-1)
    # the rest of the last block: what it has already
    keys[corners.size :] = corners[-1:, 0] if corners.size else 0
    keys = keys.reshape(block_count, width)
    keys <<= bits + 2
    keys |= np.arange(width)
    keys.sort(axis=1)
    own = keys >> bits + 2
    new = np.ones(keys.shape, bool)
    new[:, 1:] = own[:, 1:] != own[:, :-1]
    rank = np.cumsum(new, 1, dtype=np.int32) - 1
    indices = np.empty(keys.shape, np.int32)
    np.put_along_axis(indices, keys & (1 << bits + 2) - 1, rank, 1)
    vertex_first = np.zeros(block_count + 1, np.int64)
    np.cumsum(new.sum(1), out=vertex_first[1:])
    return indices.reshape(-1)[: corners.size].reshape(-1, 3), own[new], vertex_first


@wp.kernel(**KERNEL_OPTIONS)
def expand_kernel(words: wp.array(dtype=wp.uint32), out: wp.array(dtype=wp.vec4)):
    """Packed triangles as QUANTISED has them (one thread a corner)."""
    i = wp.tid()
    triangle = i // 3
    k = i - 3 * triangle
    block = triangle >> int(words[1])
    at = int(words[3]) + 2 * block
    packed = words[int(words[4]) + triangle]
    index = int((packed >> wp.uint32(8 * k)) & wp.uint32(255))
    vertex = int(words[6]) + 3 * (int(words[at]) + index)
    last = wp.uint32(0)
    if k == 0:
        high = wp.uint32(0)
        if words[2] != wp.uint32(0):
            high = words[int(words[5]) + triangle]
        else:
            high = (words[int(words[5]) + (triangle >> 1)] >> wp.uint32(16 * (triangle & 1))) & wp.uint32(0xFFFF)
        last = words[at + 1] + (high << wp.uint32(8) | packed >> wp.uint32(24))
    x = wp.cast(words[vertex], wp.float32)
    y = wp.cast(words[vertex + 1], wp.float32)
    z = wp.cast(words[vertex + 2], wp.float32)
    out[i] = wp.vec4(x, y, z, wp.cast(last, wp.float32))


PAGE_KERNELS = (expand_kernel,)


def expand_page(source: wp.array, target: wp.array, node_bytes: int, triangle_first: int, triangle_count: int) -> None:
    """Bring a packed page to the form in which it is traced, in the current stream.

    Args:
        source: the page as the store has it, uint8, where the device can read it (there, or in pinned memory), from a
            multiple of 16 on.
        target: on the device, uint8, room for the page's `device_bytes`; nothing else is written.
        node_bytes: bytes of nodes, which lie first in both.
        triangle_first: byte of `target` where its triangles begin.
        triangle_count: triangles of the page.
    """
    device = target.device
    if node_bytes:
        wp.copy(target, source, count=node_bytes)
    if triangle_count == 0:
        return
    # addresses, because a device does not take arrays that lie in pinned memory
    words = wp.array(ptr=source.ptr + node_bytes, dtype=wp.uint32, shape=(source.size - node_bytes) // 4, device=device)
    size = _VECTORS * triangle_count
    out = wp.array(ptr=target.ptr + triangle_first, dtype=wp.vec4, shape=size, device=device)
    wp.launch(expand_kernel, size, [words, out], device=device)
