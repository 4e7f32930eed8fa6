"""The binary tree that every layout is made from: its arrays, its options, its cost.

Nodes are float32 rows of eight: low corner, `a`, high corner, `count`; `a` and `count` are the bits of int32. A leaf
has `count > 0` and lists `references[a : a + count]`; an inner node has `count == 0` and the children `a` and `a + 1`.
Node 0 is the root, boxes are tight, and no leaf is deeper than `DEPTH_MAX`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import SceneError
from ..node import half_areas

# Deepest leaf, the root being at 0: a traversal stack of 64 entries always suffices
DEPTH_MAX = 63
# Two nodes a reference at most, and nodes are counted in int32
REFERENCES_MAX = 2**30
# Nodes that are looked at together when a tree is measured
_BLOCK = 1 << 18


@dataclass(frozen=True)
class BuildOptions:
    """How a tree is built. Costs are relative to the test of one group of triangles (or of boxes)."""

    leaf_group: int = 8  # triangles that are tested together: a leaf of n costs ceil(n / leaf_group); 1..8
    leaf_max: int = 8  # most references of a leaf; 1..64
    # cost of a step into a binary node, above 0; None: measured to be best for the group
    traversal_cost: float | None = None
    spatial_splits: bool = False  # split triangles where that lowers the cost
    split_budget: float = 0.3  # references that spatial splits may add, as a share of the triangles; 0..4
    # a spatial split is tried where child boxes overlap by more than this share of the root's area
    split_overlap: float = 1e-5
    thread_count: int = 0  # threads of the build, 0: as many as cores; the tree is the same for any

    def __post_init__(self) -> None:
        if not (1 <= self.leaf_group <= 8 and 1 <= self.leaf_max <= 64 and self.step_cost > 0):
            raise ValueError("leaf_group is 1..8, leaf_max 1..64, traversal_cost above 0")
        if not (0 <= self.split_budget <= 4 and self.split_overlap >= 0 and self.thread_count >= 0):
            raise ValueError("split_budget is 0..4, split_overlap and thread_count are not negative")

    @property
    def step_cost(self) -> float:
        """Cost of a step into a binary node. Several of them become one step into a wide node, which costs less than as
        many groups.
        """
        if self.traversal_cost is not None:
            return self.traversal_cost
        return 0.3 if self.leaf_group >= 4 else 1.0

    def capacity(self, triangle_count: int) -> int:
        """References that a tree over `triangle_count` triangles may have; raises `SceneError` beyond
        `REFERENCES_MAX`.
        """
        extra = int(self.split_budget * triangle_count) if self.spatial_splits else 0
        if triangle_count + extra > REFERENCES_MAX:
            raise SceneError(
                f"a mesh of {triangle_count:,} triangles needs {triangle_count + extra:,} references in its tree, and "
                "one tree holds "
                f"{REFERENCES_MAX:,}; split the mesh, or turn spatial splits off"
            )
        return triangle_count + extra


@dataclass(frozen=True, kw_only=True)
class BuildStatistics:
    """Figures of a build."""

    triangle_count: int
    node_count: int
    leaf_count: int
    reference_count: int
    duplicate_count: int  # references that spatial splits added
    depth: int  # of the deepest leaf; the root is at 0
    leaf_largest: int  # references
    node_steps: float  # inner nodes that a random ray through the root's box meets, by the surface area heuristic
    group_tests: float  # groups of `leaf_group` triangles that it tests
    sah_cost: float  # node_steps * step_cost + group_tests
    seconds: float
    memory_peak: int  # arrays of the build and its result, together [bytes]


@dataclass(frozen=True)
class BinaryTree:
    """A binary tree over the triangles of one mesh, or over boxes; no nodes when there are none."""

    nodes: np.ndarray  # float32, shape [n, 8], as above
    references: np.ndarray  # triangle (or box) of each reference, int32; with spatial splits some are listed twice
    statistics: BuildStatistics

    @property
    def links(self) -> tuple[np.ndarray, np.ndarray]:
        """Views of `a` and `count`, int32, shape [n]."""
        bits = self.nodes.view(np.int32)
        return bits[:, 3], bits[:, 7]


def box_areas(nodes: np.ndarray) -> np.ndarray:
    """Half the surface area of each node's box, float64 (which holds the squares of all of float32)."""
    return half_areas(nodes[:, 4:7].astype(np.float64) - nodes[:, :3])


def expected_visits(nodes: np.ndarray, leaf_group: int) -> tuple[float, float]:
    """Inner nodes and leaf groups that a random ray through the root's box meets (MacDonald and Booth 1990).

    (0, 0) for no nodes, and for a root without area, which a random ray misses.
    """
    if len(nodes) == 0 or not (root := box_areas(nodes[:1])[0]) > 0:
        return 0.0, 0.0
    steps = groups = 0.0
    for first in range(0, len(nodes), _BLOCK):
        block = nodes[first : first + _BLOCK]
        count = block.view(np.int32)[:, 7]
        area = box_areas(block)
        steps += float(area[count == 0].sum())
        groups += float((area * (-(-count // leaf_group))).sum())
    return float(steps / root), float(groups / root)
