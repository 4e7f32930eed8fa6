"""Trees cut into treelets, by the rules of those who proposed to queue rays at them or to prefetch them.

A treelet is a connected part of the tree with one root. Triangles belong to the treelet of the node that holds them. A
node whose bytes, triangles included, exceed the size is a treelet by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import Layout, decode_children, half_areas
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from studies.hardware.traces import NODE_WORDS, TRIANGLE_WORDS, WORD_BYTES, Addresses


@dataclass(frozen=True)
class TreeShape:
    """Nodes of a tree and what is below them."""

    children: np.ndarray  # int32, shape [node_count, 8]: nodes, -1: none
    parent: np.ndarray  # int32, shape [node_count], -1 of the root
    order: np.ndarray  # int32: nodes that the root reaches, each behind its parent, level by level
    area: np.ndarray  # half the surface area of each node's box, float64
    triangle_node: np.ndarray  # int32, shape [triangle_count]: the node that holds each triangle

    @property
    def footprint(self) -> np.ndarray:
        """Bytes of each node and its triangles, int64."""
        triangles = np.bincount(self.triangle_node, minlength=len(self.parent))
        return (NODE_WORDS + TRIANGLE_WORDS * triangles) * WORD_BYTES


def tree_shape(nodes: np.ndarray, triangle_count: int) -> TreeShape:
    """The shape of a quantised tree with node 0 as its root; `nodes` are words, uint32, shape [node_count, 20]."""
    found = decode_children(Layout.QUANTISED, nodes)
    count = len(nodes)
    children = np.where(found.inner >= 0, found.inner, -1).astype(np.int32)
    parent, area = np.full(count, -1, np.int32), np.zeros(count)
    holder, slot = np.nonzero(children >= 0)
    parent[children[holder, slot]] = holder
    area[children[holder, slot]] = half_areas(found.high[holder, slot] - found.low[holder, slot])
    area[0] = half_areas(found.high[0].max(0) - found.low[0].min(0))
    levels, level = [], np.zeros(1, np.int32)
    while len(level):
        levels.append(level)
        below = children[level]
        level = below[below >= 0]
    triangle_node = np.zeros(triangle_count, np.int32)
    for i in range(int(found.count.max(initial=0))):
        node, slot = np.nonzero(found.count > i)
        triangle_node[found.first[node, slot] + i] = node
    return TreeShape(children, parent, np.concatenate(levels).astype(np.int32), area, triangle_node)


@dataclass(frozen=True)
class Treelets:
    """Which treelet each part of a tree belongs to."""

    of_node: np.ndarray  # int32, shape [node_count]
    of_triangle: np.ndarray  # int32, shape [triangle_count]
    count: int

    def addresses(self) -> Addresses:
        """With the nodes and then the triangles of a treelet next to each other, treelet after treelet, each from the
        next sector on.
        """
        owner = np.concatenate([self.of_node, self.of_triangle])
        words = np.repeat([NODE_WORDS, TRIANGLE_WORDS], [len(self.of_node), len(self.of_triangle)])
        order = np.argsort(owner, kind="stable")
        sizes = np.bincount(owner, words, self.count).astype(np.int64)
        begins = np.concatenate([[0], np.cumsum(-(-sizes // 2) * 2)])
        inner = np.cumsum(words[order]) - words[order]
        firsts = np.concatenate([[0], np.cumsum(sizes)])[:-1]
        place = np.empty(len(owner), np.int64)
        place[order] = inner - firsts[owner[order]] + begins[owner[order]]
        assert begins[-1] < 2**31
        node, triangle = np.split(place.astype(np.int32), [len(self.of_node)])
        return Addresses(node, triangle, int(begins[-1]))

    def lines(self, addresses: Addresses, line: int, sector: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lines that hold a treelet, in the order of addresses: by treelet where its lines begin in the next two
        (int32, shape [count + 1]), the lines, and their sectors as bits.
        """
        items = np.concatenate([np.arange(len(self.of_node)), ~np.arange(len(self.of_triangle))])
        owner = np.concatenate([self.of_node, self.of_triangle])
        sectors, counts = addresses.parts(items, sector)
        per_line = line // sector
        line_count = -(-addresses.byte_count // line) + 1
        keys = np.unique(np.repeat(owner, counts).astype(np.int64) * (line_count * per_line) + sectors)
        of = keys // (line_count * per_line)
        lines = keys % (line_count * per_line) // per_line
        begins = np.flatnonzero(np.diff(of * line_count + lines, prepend=-1))
        masks = np.add.reduceat(1 << keys % per_line, begins) if len(begins) else np.zeros(0, np.int64)
        first = np.searchsorted(of[begins], np.arange(self.count + 1))
        return first.astype(np.int32), lines[begins].astype(np.int32), masks.astype(np.int32)


def breadth_first(shape: TreeShape, size: int) -> Treelets:
    """Each treelet takes nodes level by level from its root, until `size` bytes are full; what is left below begins
    treelets of its own.
    """
    footprint, children = shape.footprint.tolist(), shape.children.tolist()
    of_node, count = [-1] * len(footprint), 0
    roots = [0]
    while roots:
        later: list[int] = []
        for root in roots:
            left, waiting, i = size - footprint[root], [root], 0
            of_node[root] = count
            while i < len(waiting):
                for child in children[waiting[i]]:
                    if child >= 0:
                        if footprint[child] <= left:
                            left -= footprint[child]
                            of_node[child] = count
                            waiting.append(child)
                        else:
                            left = 0  # the first that finds no room ends the treelet
                            later.append(child)
                i += 1
            count += 1
        roots = later
    return _of(shape, np.array(of_node, np.int32))


def by_area(shape: TreeShape, size: int) -> Treelets:
    """Treelets that make the sum of the surface areas of their roots small, as far as a greedy choice does.

    After Aila and Karras 2010, the appendix on the assignment of treelets: from the leaves up, the treelet of each node
    grows by the child of largest area for its bytes, and the size at which the areas of its root and of all roots below
    it are least is remembered; from the root down these are made.
    """
    count = len(shape.parent)
    footprint = shape.footprint
    below = footprint.copy()
    for node in shape.order[:0:-1].tolist():
        below[shape.parent[node]] += below[node]
    of_node = wp.full(count, -1, dtype=int, device="cpu")
    best = wp.zeros(count, dtype=wp.float64, device="cpu")
    made = wp.zeros(1, dtype=int, device="cpu")
    cut = wp.zeros(16 + 8 * (size // (NODE_WORDS * WORD_BYTES) + 1), dtype=int, device="cpu")
    tree = Grown()
    tree.children = wp.array(shape.children, dtype=int, device="cpu")
    tree.area = wp.array(shape.area, dtype=wp.float64, device="cpu")
    tree.footprint = wp.array(footprint.astype(np.int32), dtype=int, device="cpu")
    tree.below = wp.array(below, dtype=wp.int64, device="cpu")
    tree.size = size
    tree.least = shape.area[0] * size / (10 * max(1, len(shape.order)) * NODE_WORDS * WORD_BYTES)
    order = wp.array(shape.order, dtype=int, device="cpu")
    wp.launch(_assign, 1, [tree, order, best, cut, of_node, made], device="cpu")
    return _of(shape, of_node.numpy())


def _of(shape: TreeShape, of_node: np.ndarray) -> Treelets:
    """Nodes that the root does not reach belong to the first treelet; none reads them."""
    of_node = np.maximum(of_node, 0)
    return Treelets(of_node, of_node[shape.triangle_node], int(of_node.max(initial=0)) + 1)


@wp.struct
class Grown:
    """A tree of which treelets are made."""

    children: wp.array2d(dtype=int)
    area: wp.array(dtype=wp.float64)
    footprint: wp.array(dtype=int)
    below: wp.array(dtype=wp.int64)  # bytes of each node's subtree
    size: int
    least: wp.float64  # what each treelet costs beside the area of its root


@wp.func
def _grown(tree: Grown, best: wp.array(dtype=wp.float64), cut: wp.array(dtype=int), root: int, target: wp.float64):
    """Grow the treelet of `root` until it costs `target` (below 0: as far as it goes); `cut` holds how many nodes are
    below it, and these. Returns the least cost on the way.
    """
    cut[0] = 1
    cut[1] = root
    left = int(tree.size)
    least = wp.float64(-1.0)
    go = int(1)
    while go != 0:
        chosen = int(0)
        most = wp.float64(-1.0)
        cost = tree.area[root] + tree.least
        for i in range(1, cut[0] + 1):
            node = cut[i]
            if node != root:
                cost = cost + best[node]
            if tree.footprint[node] <= left or node == root:
                bytes = wp.max(wp.min(tree.below[node], wp.int64(left)), wp.int64(1))
                score = (tree.area[node] + tree.least) / wp.float64(bytes)
                if score > most:
                    most = score
                    chosen = i
        if cut[0] != 1 or cut[1] != root:
            if least < wp.float64(0.0) or cost < least:
                least = cost
            if cost == target:
                chosen = 0
        go = chosen
        if chosen > 0:
            node = cut[chosen]
            left -= tree.footprint[node]
            cut[chosen] = cut[cut[0]]
            cut[0] = cut[0] - 1
            for j in range(8):
                if tree.children[node, j] >= 0:
                    cut[0] = cut[0] + 1
                    cut[cut[0]] = tree.children[node, j]
    return least


@wp.kernel(**KERNEL_OPTIONS)
def _assign(
    tree: Grown,
    order: wp.array(dtype=int),
    best: wp.array(dtype=wp.float64),
    cut: wp.array(dtype=int),
    of_node: wp.array(dtype=int),
    made: wp.array(dtype=int),
):
    count = order.shape[0]
    for i in range(count):
        node = order[count - 1 - i]
        best[node] = _grown(tree, best, cut, node, wp.float64(-1.0))
    # a node whose mark is below -1 begins a treelet
    of_node[order[0]] = -2
    for i in range(count):
        root = order[i]
        if of_node[root] == -2:
            _grown(tree, best, cut, root, best[root])
            for j in range(1, cut[0] + 1):
                of_node[cut[j]] = -2
            of_node[root] = made[0]
            made[0] = made[0] + 1
        for j in range(8):
            child = tree.children[root, j]
            if child >= 0:
                if of_node[child] != -2:
                    of_node[child] = of_node[root]
