"""A chunk: the tree of some triangles of a mesh, in treelets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp

from ..node import Layout


class TreeFacts(NamedTuple):
    """Facts about the tree of a chunk, as in `MeshTree`."""

    centre: np.ndarray
    box: np.ndarray
    sah: float
    depth: int


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """The tree of some triangles of a mesh, cut into treelets (as `treelets.Cut`); units are triangles, or groups of
    them (BOXES).
    """

    faces: np.ndarray  # the triangles, numbers in the mesh, int32, rising
    facts: TreeFacts
    levels: int  # of top nodes
    top_nodes: np.ndarray  # words, shape [n, words]
    top_treelet: np.ndarray  # int32, shape [n]
    treelet_root: np.ndarray  # int32, shape [T]
    top_triangles: np.ndarray  # words of the units at opened nodes, shape [u, words]
    # words of the treelets' nodes, one treelet after another, shape [m, words]; or bytes of them on a device, uint8
    nodes: np.ndarray | wp.array
    node_first: np.ndarray  # where the treelets' nodes begin, int64, shape [T + 1]
    triangles: np.ndarray | wp.array  # likewise of units
    triangle_first: np.ndarray  # likewise
    # The vertices of each triangle of treelets, int32: on a device, shape [3 * units]; on the host, [units, 3], where
    # they are not simply those of its faces
    vertices: np.ndarray | wp.array | None = None

    def treelet_bytes(self, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
        """Bytes of the nodes and of the units of each treelet, int64, shape [T]."""
        return 4 * layout.node_words * np.diff(self.node_first), 4 * layout.triangle_words * np.diff(
            self.triangle_first
        )
