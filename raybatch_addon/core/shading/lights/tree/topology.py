"""Which two nodes each node of the tree over emitters joins.

On a CPU it takes longer to find that for a triangle than all else that is made of it. Where a mesh that emits is placed
again and again, as leaves and grains are, its triangles are joined alike in all places, and only the places are sorted:
a top level over boxes of instances, as in Cycles' light trees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....bvh.build.binary import BuildOptions
from ....bvh.build.cpu.build import build_binary_from_boxes
from ....bvh.build.cuda.clusters import merge_leaves, sort_leaves
from ....bvh.build.cuda.order import find_parents, order_by_height, refit
from ..emitters import EmissiveTriangles

# Fewer emissive triangles are sorted one by one: that takes no tenth of a second, and the tree is a little better where
# instances overlap
_MANY = 1 << 17
_OPTIONS = BuildOptions(leaf_group=1, leaf_max=1)


@wp.struct
class Joints:
    """A binary tree over emitters: leaves [0, leaf_count) first, inner node `leaf_count + k` at k."""

    leaf_count: int
    low: wp.array(dtype=wp.vec3)  # of boxes of all nodes, once they are joined [m]
    high: wp.array(dtype=wp.vec3)
    children: wp.array(dtype=wp.vec2i)
    which: wp.array(dtype=int)  # which emitter a leaf is


@dataclass(frozen=True)
class Topology:
    """The joints, and the order in which nodes are joined."""

    joints: Joints
    order: wp.array  # inner nodes, those below others first, int
    level_first: list[int]  # index in `order` of the first of each level, then their count
    root: int


@dataclass(frozen=True)
class Alike:
    """Runs of emitters that are the same triangles in several places."""

    first: np.ndarray  # of each run, int64, shape [runs]
    count: int  # emitters of each, at least two

    def rows(self) -> np.ndarray:
        """The emitters of each run, int64, shape [runs, count]."""
        return self.first[:, None] + np.arange(self.count)


def runs_alike(triangles: EmissiveTriangles, mesh: np.ndarray, first_number: int) -> list[Alike]:
    """The runs of `triangles` that are joined alike; none where there are few triangles.

    `mesh` is that of each instance, int, shape [instance_count]; triangles are numbered from `first_number` on.
    """
    if len(triangles) < _MANY:
        return []
    counts = np.diff(triangles.instance_first)
    placed = np.flatnonzero(counts > 1)
    keys, group = np.unique(np.stack([mesh[placed], counts[placed]], 1), axis=0, return_inverse=True)
    found = []
    for number, count in enumerate(keys[:, 1].tolist()):
        first = triangles.instance_first[placed[group.reshape(-1) == number]].astype(np.int64)
        # some triangles of a mesh may be dark or flat in one place alone
        primitives = triangles.primitive[first[:, None] + np.arange(count)]
        same = (primitives == primitives[0]).all(1)
        if same.sum() > 1:
            found.append(Alike(first_number + first[same], count))
    return found


def topology_on_cuda(low: wp.array, high: wp.array) -> Topology:
    """The tree over boxes, which are at least two."""
    tree, clusters = sort_leaves(low, high)
    merge_leaves(tree, clusters)
    nodes = tree.nodes
    links = find_parents(nodes)
    refit(nodes, links)
    heights = order_by_height(nodes, links)
    if heights is None:
        raise RuntimeError("the tree of emitters is too high, though merging bounds its height")
    joints = Joints()
    joints.leaf_count = nodes.leaf_count
    joints.low, joints.high = nodes.low, nodes.high
    joints.children, joints.which = nodes.children, nodes.primitive
    return Topology(joints, heights.node, heights.first, 2 * nodes.leaf_count - 2)


def topology_on_cpu(low: np.ndarray, high: np.ndarray, alike: Sequence[Alike] = ()) -> Topology:
    """The tree over boxes, float32, shape [n, 3], n at least two; those of `alike` are joined as the first of their
    runs are.
    """
    count = len(low)
    alone = np.ones(count, bool)
    for runs in alike:
        alone[runs.rows()] = False
    # what the top level is over: emitters alone, then each run of each group
    single = np.flatnonzero(alone)
    roots, lows, highs = [single], [low[single]], [high[single]]
    children = np.empty((count - 1, 2), np.int32)
    by_depth: list[list[np.ndarray]] = []  # nodes below the top level, by their depth in a run
    made = 0  # inner nodes that have a number
    for runs in alike:
        rows = runs.rows()
        part = _Part.over(low[rows[0]], high[rows[0]])
        base = count + made + np.arange(len(rows))[:, None] * len(part.children)
        children[made : made + len(rows) * len(part.children)] = part.numbered(rows, base)
        made += len(rows) * len(part.children)
        by_depth += [[] for _ in range(len(part.levels) - len(by_depth))]
        for depth, nodes in enumerate(part.levels):
            by_depth[depth].append((base + nodes).reshape(-1))
        roots.append(base[:, 0])
        lows.append(low[rows].min(1))
        highs.append(high[rows].max(1))
    levels = [np.concatenate(each) for each in reversed(by_depth)]
    items = np.concatenate(roots)
    root = int(items[0])
    if len(items) > 1:
        part = _Part.over(np.concatenate(lows), np.concatenate(highs))
        root = count + made
        children[made:] = part.numbered(items[None], np.full((1, 1), root))
        levels += [root + nodes for nodes in reversed(part.levels)]
    joints = Joints()
    joints.leaf_count = count
    joints.low, joints.high = (wp.empty(2 * count - 1, dtype=wp.vec3, device="cpu") for _ in range(2))
    joints.children = wp.array(children, dtype=wp.vec2i, device="cpu")
    joints.which = wp.array(np.arange(count, dtype=np.int32), dtype=int, device="cpu")
    order = wp.array(np.concatenate(levels).astype(np.int32), dtype=int, device="cpu")
    return Topology(joints, order, np.cumsum([0, *map(len, levels)]).tolist(), root)


@dataclass(frozen=True)
class _Part:
    """A binary tree over items, at least two."""

    children: np.ndarray  # of each inner node, the root first: an item, or the number of items + an inner node
    levels: list[np.ndarray]  # inner nodes by their depth

    @staticmethod
    def over(low: np.ndarray, high: np.ndarray) -> _Part:
        """By the surface area heuristic over boxes, float32, shape [n, 3]."""
        built = build_binary_from_boxes(low, high, _OPTIONS)
        below, size = built.links
        leaves, inner = np.flatnonzero(size > 0), np.flatnonzero(size == 0)
        number = np.empty(len(size), np.int32)  # of each node here
        number[leaves] = built.references[below[leaves]]
        number[inner] = len(leaves) + np.arange(len(inner))
        levels, level = [], np.zeros(1, np.int64)
        while len(level := level[size[level] == 0]):
            levels.append(number[level] - len(leaves))
            level = np.concatenate([below[level], below[level] + 1]).astype(np.int64)
        return _Part(number[np.stack([below[inner], below[inner] + 1], 1)], levels)

    def numbered(self, items: np.ndarray, base: np.ndarray) -> np.ndarray:
        """The children of copies of the tree: int32, shape [copies * inner nodes, 2].

        `items` are the numbers of the items of each copy, int, shape [copies, items], `base` that of its first inner
        node, shape [copies, 1].
        """
        numbers = np.concatenate([items, base + np.arange(len(self.children))], 1, dtype=np.int32, casting="unsafe")
        return numbers[:, self.children.reshape(-1)].reshape(-1, 2)
