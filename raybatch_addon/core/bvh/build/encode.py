"""Writing the blocks of a tree, for CPU and CUDA: child boxes become nodes, vertices are placed in triangle blocks.

The C++ of nodes (`native/encode/boxes.h`, `quantised.h`) is part of native functions that have found the boxes of
children: of a binary tree when a tree is made, of the triangles and nodes below when it is refitted.
"""

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...native.build import native_source
from ..margin import SLAB_MARGIN
from ..node import BOXES_DEFINES, Layout, aligned_empty

ENCODE_BOXES = BOXES_DEFINES | {"SLAB_MARGIN": SLAB_MARGIN}
"""Macros of native functions that write nodes of BOXES."""
ENCODE_QUANTISED = {"SLAB_MARGIN": SLAB_MARGIN, "NODE_WORDS": Layout.QUANTISED.node_words}
"""Macros of native functions that write nodes of QUANTISED."""


@wp.func_native(native_source("encode/place_group.h", **BOXES_DEFINES))
def place_group(
    i: int, blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
): ...


@wp.func_native(native_source("encode/place_triangle.h", TRIANGLE_WORDS=Layout.QUANTISED.triangle_words))
def place_triangle(
    i: int, blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
): ...


@wp.kernel(**KERNEL_OPTIONS)
def place_groups_kernel(
    blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
):
    """Vertices into groups of triangles of BOXES, by their faces (one thread a group)."""
    place_group(wp.tid(), blocks, positions, triangles)


@wp.kernel(**KERNEL_OPTIONS)
def place_triangles_kernel(
    blocks: wp.array(dtype=wp.vec4), positions: wp.array(dtype=wp.vec3), triangles: wp.array(dtype=wp.vec3i)
):
    """Vertices into triangles of QUANTISED, by their faces (one thread a triangle)."""
    place_triangle(wp.tid(), blocks, positions, triangles)


def as_vectors(words: np.ndarray) -> wp.array:
    """The memory of nodes or triangle blocks as kernels on the CPU take it."""
    return wp.array(words.view(np.float32).reshape(-1, 4), dtype=wp.vec4, device="cpu", copy=False)


def empty_vectors(count: int, device: wp.Device) -> wp.array:
    """`count` elements of nodes or triangle blocks, aligned as traversal wants them."""
    if device.is_cuda:
        return wp.empty(count, dtype=wp.vec4, device=device)
    return as_vectors(aligned_empty((count, 4), np.float32))
