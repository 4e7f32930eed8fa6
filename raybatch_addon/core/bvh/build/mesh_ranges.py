"""The tree of a mesh whose vertices move, over ranges of time: the same nodes and triangles, with boxes around where
these are in each range.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ..node import Layout, half_areas
from .encode import empty_vectors
from .refit import NodeLevels, refit_boxes, refit_quantised
from .time_ranges import RANGE_GAIN_LEAST, RANGES_MOST, bounds


@dataclass(frozen=True)
class MeshRanges:
    """A mesh tree in each of some ranges of time."""

    box: np.ndarray  # float32, shape [ranges, 2, 3]
    sah: np.ndarray  # as `MeshTree.sah`, float64, shape [ranges]
    centre: np.ndarray  # float32, shape [ranges, 3]
    nodes: wp.array | None = None  # vec4, range behind range; None: those of the tree itself, or not kept

    @property
    def count(self) -> int:
        """Ranges."""
        return len(self.sah)

    @property
    def cost(self) -> float:
        """The mean over time of a ray's expected steps, times the area that it may meet."""
        return float((half_areas(self.box[:, 1].astype(np.float64) - self.box[:, 0]) * self.sah).mean())

    def without_nodes(self) -> MeshRanges:
        """Its figures alone."""
        return replace(self, nodes=None)


# Positions, and the triangles or what stands in for segments of curves over them, from one time to another
Between = Callable[[float, float], tuple[Sequence[np.ndarray], np.ndarray]]


def refitted_ranges(
    nodes: wp.array, blocks: wp.array, layout: Layout, levels: NodeLevels | None, between: Between, count: int
) -> MeshRanges:
    """A tree in `count` ranges.

    Args:
        nodes, blocks: of the tree; the triangles of one time, of which the numbers alone count.
        levels: of its nodes, where the layout is QUANTISED.
        between: what its boxes are to hold.
    """
    device = nodes.device
    joined = empty_vectors(nodes.size * count, device)
    room = blocks  # triangles, once for each of the positions that a range has
    found = []
    for i in range(count):
        corners, triangles = between(*bounds(i, count))
        positions = [wp.array(each, dtype=wp.vec3, device=device) for each in corners]
        faces = wp.array(np.ascontiguousarray(triangles), dtype=wp.vec3i, device=device)
        if room is blocks or room.size < blocks.size * len(positions):
            room = empty_vectors(blocks.size * len(positions), device)
            for k in range(len(positions)):
                wp.copy(room, blocks, dest_offset=k * blocks.size)
        placed = room[: blocks.size * len(positions)]
        own = joined[i * nodes.size : (i + 1) * nodes.size]
        wp.copy(own, nodes)
        if layout is Layout.QUANTISED:
            assert levels is not None, "levels of QUANTISED"
            found.append(refit_quantised(own, placed, levels, positions, faces))
        else:
            found.append(refit_boxes(own, placed, positions, faces))
    return MeshRanges(
        np.stack([each.box for each in found]),
        np.array([each.sah for each in found]),
        np.stack([each.centre for each in found]),
        joined,
    )


def worthwhile(whole: MeshRanges, most: int, refitted: Callable[[int], MeshRanges]) -> list[MeshRanges]:
    """`whole`, of one range, and the same with 2, 4, ... as long as that pays; at most `most`. The last alone has its
    nodes.
    """
    found = [whole]
    while 2 * found[-1].count <= min(most, RANGES_MOST):
        finer = refitted(2 * found[-1].count)
        if not finer.cost < (1 - RANGE_GAIN_LEAST) * found[-1].cost:
            break
        found[-1] = found[-1].without_nodes()  # a refit has them again, where fewer are chosen for the whole scene
        found.append(finer)
    return found
