"""Triangles packed on a device, to the same words as `encode_triangles` of `encode.py` makes of them on the host.

Which of its block's corners are first to have their vertex, and how many vertices of lower numbers the block has, each
corner finds by itself: it looks at the other corners, which neighbours look at at the same time.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....native.structs import to_numpy
from ..encode import BLOCK_BITS, BLOCK_VERTICES_MAX, HEADER_WORDS

_NO_VERTEX = wp.constant(2**31 - 1)
_VERTICES, _ABOVE, _ALL = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.struct
class PackedBlocks:
    """Blocks of triangles that are packed together; corners one after another, three a triangle."""

    triangles: wp.array(dtype=int)  # words of QUANTISED
    vertices: wp.array(dtype=int)  # of each corner
    listed: wp.array(dtype=int)  # the same of the first corner of a block that has it, elsewhere `_NO_VERTEX`
    rank: wp.array(dtype=int)  # of each corner: its vertex among those of the block
    counts: wp.array(dtype=int)  # vertices of each block
    first: wp.array(dtype=int)  # the same of all blocks before
    lowest: wp.array(dtype=int)  # lowest face of each block
    # most vertices of a block, greatest difference of a face to the lowest, vertices of all blocks
    found: wp.array(dtype=int)
    count: int  # triangles
    bits: int  # of a triangle's index in its block


@wp.kernel(**KERNEL_OPTIONS)
def list_vertices_kernel(blocks: PackedBlocks):
    """The first corners of their vertices (one thread a corner)."""
    i = wp.tid()
    block = i // (3 << blocks.bits)
    vertex = blocks.vertices[i]
    listed = vertex
    for j in range(block * (3 << blocks.bits), i):
        if blocks.vertices[j] == vertex:
            listed = _NO_VERTEX
            break
    blocks.listed[i] = listed
    if listed != _NO_VERTEX:
        wp.atomic_add(blocks.counts, block, 1)
    if i % 3 == 0:
        wp.atomic_min(blocks.lowest, block, blocks.triangles[4 * i + 3])


@wp.kernel(**KERNEL_OPTIONS)
def rank_vertices_kernel(blocks: PackedBlocks):
    """Places of vertices in the lists of blocks, and what the form of the words depends on (one thread a corner)."""
    i = wp.tid()
    block = i // (3 << blocks.bits)
    vertex = blocks.vertices[i]
    rank = int(0)
    start = block * (3 << blocks.bits)
    for j in range(start, wp.min(start + (3 << blocks.bits), 3 * blocks.count)):
        if blocks.listed[j] < vertex:
            rank += 1
    blocks.rank[i] = rank
    if i % 3 == 0:
        wp.atomic_max(blocks.found, _ABOVE, blocks.triangles[4 * i + 3] - blocks.lowest[block])
    if i == start:
        wp.atomic_max(blocks.found, _VERTICES, blocks.counts[block])
        wp.atomic_add(blocks.found, _ALL, blocks.counts[block])


@wp.kernel(**KERNEL_OPTIONS)
def pack_kernel(blocks: PackedBlocks, header: wp.array(dtype=int), words: wp.array(dtype=int)):
    """The packed words (one thread a triangle)."""
    i = wp.tid()
    block = i >> blocks.bits
    table = header[3] + 2 * block
    if i < HEADER_WORDS:
        words[i] = header[i]
    if i == block << blocks.bits:
        words[table] = blocks.first[block]
        words[table + 1] = blocks.lowest[block]
    above = blocks.triangles[12 * i + 3] - blocks.lowest[block]
    packed = (above & 255) << 24
    for k in range(3):
        corner = 3 * i + k
        rank = blocks.rank[corner]
        packed = packed | (rank << (8 * k))
        if blocks.listed[corner] != _NO_VERTEX:
            at = header[6] + 3 * (blocks.first[block] + rank)
            for axis in range(3):
                words[at + axis] = blocks.triangles[12 * i + 4 * k + axis]
    words[header[4] + i] = packed
    if header[2] != 0:
        words[header[5] + i] = above >> 8
    elif i % 2 == 0:
        high = above >> 8
        if i + 1 < blocks.count:
            next_block = (i + 1) >> blocks.bits
            high = high | (((blocks.triangles[12 * i + 15] - blocks.lowest[next_block]) >> 8) << 16)
        words[header[5] + (i >> 1)] = high


ENCODE_KERNELS = (list_vertices_kernel, rank_vertices_kernel, pack_kernel)


def encode_on_device(triangles: wp.array, vertices: wp.array) -> wp.array:
    """The packed words, int32, on the device of `triangles`.

    Args:
        triangles: words of a QUANTISED tree, int32 [12 n].
        vertices: of each corner, int32 [3 n], not negative.
    """
    device, count = triangles.device, triangles.size // 12
    blocks = PackedBlocks()
    blocks.triangles, blocks.vertices, blocks.count = triangles, vertices, count
    blocks.listed, blocks.rank = (wp.empty(3 * count, dtype=int, device=device) for _ in range(2))
    found = [0, 0, 0]
    for bits in BLOCK_BITS:
        blocks.bits, block_count = bits, -(-count >> bits)
        blocks.counts = wp.zeros(block_count, dtype=int, device=device)
        blocks.first = wp.empty(block_count, dtype=int, device=device)
        blocks.lowest = wp.full(block_count, 2**31 - 1, dtype=int, device=device)
        blocks.found = wp.zeros(3, dtype=int, device=device)
        if count == 0:
            break
        wp.launch(list_vertices_kernel, 3 * count, [blocks], device=device)
        wp.launch(rank_vertices_kernel, 3 * count, [blocks], device=device)
        found = to_numpy(blocks.found).tolist()
        if found[0] <= BLOCK_VERTICES_MAX:
            break
    wide = found[1] >= 1 << 24
    sizes = [2 * block_count, count, count if wide else -(-count // 2), 3 * found[2]]
    ends = HEADER_WORDS + np.cumsum([0, *sizes])
    header = np.zeros(HEADER_WORDS, np.int32)
    header[:7] = count, bits, wide, *ends[:4]
    if count < HEADER_WORDS:
        words = np.zeros(ends[4], np.int32)
        words[:HEADER_WORDS] = header
        words = wp.array(words, dtype=int, device=device)
    else:
        words = wp.empty(int(ends[4]), dtype=int, device=device)
    if count:
        wp.utils.array_scan(blocks.counts, blocks.first, inclusive=False)
        header = wp.array(header, dtype=int, device=device)
        wp.launch(pack_kernel, count, [blocks, header, words], device=device)
    return words
