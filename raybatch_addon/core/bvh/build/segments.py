"""Trees over segments of curves: built over triangles that stand for them, whose boxes are theirs."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...scene.segments import are_segments, segment_boxes, segment_boxes_over
from ..node import Layout
from .encode import place_groups_kernel, place_triangles_kernel


def stand_ins(
    positions: np.ndarray, triangles: np.ndarray, steps: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions and triangles with the boxes of the primitives given, or None where none of these is a segment.

    Such a triangle is a diagonal of its box, and must not be split.

    Args:
        positions: float32, shape [n, 3].
        triangles: int32, shape [m, 3], some of which are segments (`scene/segments.py`).
        steps: the positions at several times between which all of them move along lines, shape [k, n, 3]. All
            triangles are segments then.
    """
    marked = are_segments(positions, triangles)
    if not marked.any():
        return None
    if steps is None:
        low, high = segment_boxes(positions, triangles[marked])
    else:
        low, high = segment_boxes_over(steps, triangles)
    first = len(positions) + np.arange(len(low), dtype=np.int32)
    replaced = triangles.copy()
    replaced[marked] = np.stack([first, first + len(low), first + len(low)], 1)
    return np.concatenate([positions, low, high]), replaced


def place_primitives(
    blocks: wp.array, layout: Layout, positions: wp.array | np.ndarray, triangles: wp.array | np.ndarray
) -> None:
    """Write the primitives themselves into the blocks of a tree that was built over `stand_ins`: `positions` and
    `triangles` are what these were made of, as arrays of the device of `blocks` or of NumPy.
    """
    kernel = place_groups_kernel if layout is Layout.BOXES else place_triangles_kernel
    device, count = blocks.device, 4 * blocks.size // layout.triangle_words
    if isinstance(positions, np.ndarray):
        positions = wp.array(positions, dtype=wp.vec3, device=device, copy=False)
        triangles = wp.array(np.ascontiguousarray(triangles), dtype=wp.vec3i, device=device, copy=False)
    wp.launch(kernel, dim=count, inputs=[blocks, positions, triangles], device=device)
