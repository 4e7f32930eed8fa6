"""Which two nodes each node of the tree over emitters joins.

On a CPU it takes longer to find that for a triangle than all else that is made of it. Where a mesh that emits is placed
again and again, as leaves and grains are, its triangles are joined alike in all places, and only the places are sorted:
a top level over boxes of instances, as in Cycles' light trees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....bvh.build.binary import BuildOptions
from ....bvh.build.cpu.build import build_binary_from_boxes
from ....bvh.build.cuda.clusters import merge_leaves, sort_leaves
from ....bvh.build.cuda.order import find_parents, order_by_height, refit
from ....device.bulk import large_empty
from ..emitters import EmissiveTriangles
from .joints import Joints, widen_leaves_kernel

# Fewer emissive triangles are sorted one by one: that takes no tenth of a second, and the tree is a little better where
# instances overlap
_MANY = 1 << 17
_OPTIONS = BuildOptions(leaf_group=1, leaf_max=1)


@dataclass(frozen=True)
class Subtree:
    """A part of the tree that is joined by itself: what is looked at stays in a core's cache."""

    leaf_first: int  # its leaves have numbers that follow one another
    leaf_count: int
    level_first: list[int]  # as `Topology.level_first`, then the end of the last level


@dataclass(frozen=True)
class Topology:
    """The joints, and the order in which nodes are joined."""

    joints: Joints
    order: wp.array  # inner nodes, those below others first, int
    subtrees: list[Subtree]  # joined first, in any order
    leaves: list[tuple[int, int]]  # begin and end of the leaves that are in none of them
    level_first: list[int]  # index in `order` of the first of each level above them, then their count
    root: int


@dataclass(frozen=True)
class Alike:
    """Runs of emitters that are the same triangles in several places."""

    first: np.ndarray  # of each run, int64, shape [runs]
    count: int  # emitters of each, at least two


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
        primitives = [triangles.primitive[begin : begin + count] for begin in first.tolist()]
        same = np.array([np.array_equal(each, primitives[0]) for each in primitives])
        if same.sum() > 1:
            found.append(Alike(first_number + first[same], count))
    return found


def topology_on_cuda(low: wp.array, high: wp.array) -> Topology:
    """The tree over boxes, which are at least two."""
    tree, clusters = sort_leaves(low, high)
    half = _least_half(tree.box[0], tree.box[1], low.size)
    wp.launch(widen_leaves_kernel, low.size, [tree.nodes.low, tree.nodes.high, half], device=low.device)
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
    leaves = [(0, nodes.leaf_count)]
    return Topology(joints, heights.node, [], leaves, heights.first, 2 * nodes.leaf_count - 2)


def _least_half(low: np.ndarray, high: np.ndarray, count: int) -> float:
    """Half the width that boxes of `count` emitters, all of them within the corners `low` and `high`, float32, shape
    [3], have at least when they are joined: the step between so many in rows and columns.

    The surface of a box counts, and one over emitters in a plane has none to speak of: rows of lamps along a ceiling
    would be joined to strips, whose middles say little of where their light comes from.
    """
    return float((high.astype(np.float64) - low).max()) / np.sqrt(count)


def topology_on_cpu(low: np.ndarray, high: np.ndarray, alike: Sequence[Alike] = ()) -> Topology:
    """The tree over boxes, float32, shape [n, 3], n at least two; those of `alike` are joined as the first of their
    runs are.
    """
    count = len(low)
    alone = np.ones(count, bool)
    for runs in alike:
        for first in runs.first.tolist():
            alone[first : first + runs.count] = False
    # what the top level is over: emitters alone, then each run of each group
    single = np.flatnonzero(alone)
    roots, lows, highs = [single], [low[single]], [high[single]]
    children, order = np.empty((count - 1, 2), np.int32), np.empty(count - 1, np.int32)
    subtrees: list[Subtree] = []
    made = 0  # inner nodes that have a number, and a place in the order
    for runs in alike:
        first = int(runs.first[0])
        part = _Part.over(low[first : first + runs.count], high[first : first + runs.count])
        inner, nodes = len(part.children), np.concatenate(part.levels[::-1])
        level_first = np.cumsum([0, *map(len, part.levels[::-1])])
        base = count + made + np.arange(len(runs.first)) * inner
        roots.append(base)
        lows.append(_over_runs(np.min, low, runs))
        highs.append(_over_runs(np.max, high, runs))
        for first, number in zip(runs.first.tolist(), base.tolist()):
            part.number(first, number, children[made : made + inner])
            np.add(nodes, number, out=order[made : made + inner], casting="unsafe")
            subtrees.append(Subtree(first, runs.count, (level_first + made).tolist()))
            made += inner
    items, level_first, root = np.concatenate(roots), [made], int(roots[-1][-1])
    if len(items) > 1:
        part = _Part.over(np.concatenate(lows), np.concatenate(highs))
        root = count + made
        children[made:] = part.numbered(items, root)
        order[made:] = root + np.concatenate(part.levels[::-1])
        level_first = (made + np.cumsum([0, *map(len, part.levels[::-1])])).tolist()
    joints = Joints()
    joints.leaf_count = count
    joints.low, joints.high = (large_empty(2 * count - 1, wp.vec3, wp.get_device("cpu")) for _ in range(2))
    joints.children = wp.array(children, dtype=wp.vec2i, device="cpu", copy=False)
    joints.which = wp.array(np.arange(count, dtype=np.int32), dtype=int, device="cpu", copy=False)
    order = wp.array(order, dtype=int, device="cpu", copy=False)
    return Topology(joints, order, subtrees, _ranges(alone), level_first, root)


def _over_runs(choose: Callable[..., np.ndarray], corners: np.ndarray, runs: Alike) -> np.ndarray:
    """What `choose`, `np.min` or `np.max`, finds of `corners`, float32, shape [n, 3], over each run."""
    # row by row: NumPy goes slowly along axes of three
    return np.stack([choose(corners[i : i + runs.count].T.copy(), 1) for i in runs.first.tolist()])


def _ranges(chosen: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of each run of True in `chosen`, bool, shape [n]."""
    ends = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    return list(zip(ends[::2].tolist(), ends[1::2].tolist()))


@dataclass(frozen=True)
class _Part:
    """A binary tree over items, at least two."""

    children: np.ndarray  # of each inner node, the root first: an item, or the number of items + an inner node
    levels: list[np.ndarray]  # inner nodes by their depth

    @staticmethod
    def over(low: np.ndarray, high: np.ndarray) -> _Part:
        """By the surface area heuristic over boxes, float32, shape [n, 3]."""
        half = np.float32(_least_half(low.min(0), high.max(0), len(low)))
        middle = 0.5 * low + 0.5 * high
        built = build_binary_from_boxes(np.minimum(low, middle - half), np.maximum(high, middle + half), _OPTIONS)
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

    def numbered(self, items: np.ndarray, base: int) -> np.ndarray:
        """The children of the tree where its items have the numbers `items`, int, shape [n], and its inner nodes those
        from `base` on: int32, shape [inner nodes, 2].
        """
        numbers = np.concatenate([items, base + np.arange(len(self.children))])
        return numbers[self.children].astype(np.int32)

    def number(self, first: int, base: int, out: np.ndarray) -> None:
        """The same where items have the numbers from `first` on, written to `out`."""
        item_count = len(self.children) + 1
        np.add(self.children, np.where(self.children < item_count, first, base - item_count), out=out, casting="unsafe")
