"""The memory of its device that a render will take, estimated from counts alone."""

from __future__ import annotations

from dataclasses import dataclass

from ..bvh.memory import GeometrySize
from ..bvh.node import Layout
from ..film.channels import layout_of
from ..film.layout import channels_of
from ..film.sums import WINDOW_DIGITS
from ..scene.description import Frame


@dataclass(frozen=True)
class MemoryEstimate:
    """Memory of a render once it runs [bytes]. A build may need more for a while (`bvh/memory.py`), the film is left
    out.
    """

    path_bytes: int  # of one path alive
    path_count: int  # paths alive
    geometry: int  # what shading reads: corners, positions, normals
    tree: int  # nodes and triangles of all mesh trees, and the top level
    resident: int  # of `tree`, what is on the device

    @property
    def rays(self) -> int:
        """Memory of all paths alive [bytes]."""
        return self.path_bytes * self.path_count

    @property
    def behind(self) -> int:
        """What of `tree` waits in host memory or on disk."""
        return self.tree - self.resident

    @property
    def device(self) -> int:
        """All that is on the device."""
        return self.rays + self.geometry + self.resident


def estimate_memory(
    size: GeometrySize, layout: Layout, path_bytes: int, path_count: int, budget: int = 0, tree_bytes: int | None = None
) -> MemoryEstimate:
    """The estimate for geometry of this size, and `path_count` paths alive that take `path_bytes` each.

    `budget`: the setting `geometry_budget` [bytes]; 0: the tree is on the device whole. `tree_bytes`: what the tree
    takes, where that is known; otherwise it is the least for so many triangles and entries.
    """
    tree = size.tree_bytes(layout) if tree_bytes is None else tree_bytes
    return MemoryEstimate(path_bytes, path_count, size.arrays(), tree, min(tree, budget) if budget else tree)


def film_bytes(frame: Frame, half_count: int) -> tuple[int, int]:
    """What the sums of a film of `frame` take on the device that renders it, and what its pictures take in the host's
    memory; both in halves where there are 2 [bytes].
    """
    sums = (layout_of(frame.passes, frame.transparent).count * WINDOW_DIGITS + 1) * 8 * half_count
    pictures = sum(channels_of(name) for name in frame.passes) * 4 * (3 if half_count == 2 else 1)
    return frame.pixel_count * sums, frame.pixel_count * pictures
