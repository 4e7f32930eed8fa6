"""The cut of a mesh tree into a few resident nodes and treelets.

A *treelet* is a subtree that is visited as a unit. Its root is resident; the nodes and triangles below the root form
two blocks, whose indices, the root's too, are relative to the block's first. What is above the treelets is resident:
*opened* nodes, with the triangles of their leaves. So every resident node is either opened or the root of a treelet.

Where vertices move, a block has the triangles of all *steps*, those of one step behind another, and so have the
resident ones; nodes count those of one step.

Words are those of an uncut tree (`node.py`) with other indices: QUANTISED children stay contiguous in the order of
slots, and a node's triangles stay contiguous and in their order, so that `meta` bytes hold as they are. In BOXES a
child that is the root of a treelet is marked with `TREELET_CHILD`, in QUANTISED only a table by node
says so (`Cut.top_treelet`).

The cut follows MIN_TREELETSIZE, TREELETSIZE and BVH_MAXDEPTH of the thesis (section 3.2), and besides a limit in bytes
and one for what is resident, which opens nodes by surface area: what rays meet most often. Nothing here depends on the
order in which nodes lie. Loops run over levels only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..node import Layout
from .links import TREELET_CHILD, Links, Order, breadth_first, ends_of, links_of, node_areas, ranges, with_links

_TOP_NODES_MAX = TREELET_CHILD  # of BOXES, by that bit


@dataclass(frozen=True)
class CutRule:
    """The rule by which a tree is cut. A node without inner children is never opened; the root's depth is 0.

    A rule that limits neither `size` nor `bytes_max` nor `top_bytes_max` makes one treelet. With `top_bytes_max` alone
    every node may be opened.
    """

    size: int = 0
    """Most nodes of a treelet, its root among them; 0: no limit."""
    size_min: int = 1
    """A node is not opened if the subtree of an inner child has fewer nodes (the thesis's rule), however large it is
    itself.
    """
    depth_max: int = 64
    """A node this deep is a treelet whatever its size."""
    bytes_max: int = 0
    """Most bytes of a treelet's nodes and triangles, its root among them; 0: no limit. A node that is larger by itself
    stays so.
    """
    top_bytes_max: int = 0
    """Nodes are opened from the largest surface area on, until resident nodes and triangles would take more bytes; 0:
    no limit.
    """

    tier_bytes: int = 0
    """Most bytes of a large treelet, which holds treelets and the resident nodes between their roots and its own; 0:
    there are none. Roots of trees are no large treelets, nor those of treelets.
    """

    @property
    def cuts_nothing(self) -> bool:
        """Whether every tree is one treelet."""
        return not (self.size or self.bytes_max or self.top_bytes_max)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"{name} of a cut is {value}, and must be 0 or more")


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A mesh tree that was cut. Units are triangles (QUANTISED) or groups of triangles (BOXES).

    Treelets are numbered in depth-first order of their roots: neighbours in number are neighbours in space.
    """

    layout: Layout
    # words of the resident nodes, shape [n_top, words]; the root first, children after their parents
    top_nodes: np.ndarray
    top_treelet: np.ndarray  # int32, shape [n_top]: treelet whose root this is, or -1
    treelet_root: np.ndarray  # int32, shape [T]: index in `top_nodes`
    nodes: np.ndarray  # words below the roots, shape [m, words], one treelet after another
    node_first: np.ndarray  # int64, shape [T + 1]: where the treelets' nodes begin in `nodes`
    # int64, shape [units of all steps]: old index of each unit: the resident ones, then treelet by treelet
    triangle_order: np.ndarray
    triangle_first: np.ndarray  # int64, shape [T + 1]: where the treelets' units begin in `triangle_order`
    levels: int  # levels of resident nodes, at least 1
    top_large: np.ndarray  # int32, shape [n_top]: large treelet whose root this is, or -1
    treelet_large: np.ndarray  # int32, shape [T]: large treelet that a treelet is in, or -1
    steps: int = 1  # of vertices that move, which all blocks have; step k of unit i was unit k * units + i

    @property
    def treelet_count(self) -> int:
        """Treelets, at least 1."""
        return len(self.treelet_root)

    @property
    def treelet_sizes(self) -> np.ndarray:
        """Nodes of each treelet, its root among them, int64, shape [T]."""
        return np.diff(self.node_first) + 1

    @property
    def treelet_bytes(self) -> np.ndarray:
        """Bytes of each treelet's nodes and triangles, its root among them, int64, shape [T]."""
        return 4 * (
            self.layout.node_words * self.treelet_sizes + self.layout.triangle_words * np.diff(self.triangle_first)
        )

    @property
    def top_triangle_count(self) -> int:
        """Units that are resident."""
        return int(self.triangle_first[0])

    @property
    def deform(self) -> tuple[int, np.ndarray]:
        """Units of one step: of the resident ones, and of each treelet; 0 where vertices do not move."""
        moves = self.steps > 1
        return moves * self.top_triangle_count // self.steps, moves * np.diff(self.triangle_first) // self.steps


def cut_nodes(layout: Layout, nodes: np.ndarray, rule: CutRule, steps: int = 1) -> Cut:
    """Cut the tree whose words are `nodes`, shape [n, words of a node]; they are left as they are. There are units for
    each of `steps`.

    Raises `ValueError` where they are not one tree, or its leaves do not list every unit once.
    """
    nodes = np.ascontiguousarray(nodes)
    links = links_of(layout, nodes)
    order = breadth_first(links)
    units = steps * np.bincount(links.run_node, links.run_count, len(nodes)).astype(np.int64)[order.node]
    size, below = order.totals(np.ones(len(nodes), np.int64)), order.totals(units)
    opened, resident = _opened(layout, nodes, rule, order, size, below, units)
    node_bytes, unit_bytes = 4 * layout.node_words, 4 * layout.triangle_words
    is_large, large_at = _large(order, opened, node_bytes * size + unit_bytes * below, rule.tier_bytes)
    treelet_at, levels = _treelets(order, opened, resident, size)

    by_node = np.empty(len(nodes), np.int32)
    by_node[order.node] = treelet_at  # treelet that a node is in, its root included; -1 for opened nodes
    is_resident = np.empty(len(nodes), bool)
    is_resident[order.node] = resident
    is_large_root, in_large = np.zeros(len(nodes), bool), np.empty(len(nodes), np.int32)
    is_large_root[order.node], in_large[order.node] = is_large, large_at
    top = np.flatnonzero(is_resident)
    rest = np.flatnonzero(~is_resident)
    treelet_count = int(treelet_at.max()) + 1
    if treelet_count > 1:
        rest = rest[_stable_order(by_node[rest])]
    node_first = ends_of(np.bincount(by_node[rest], minlength=treelet_count))
    index = np.empty(len(nodes), np.int32)
    index[top] = np.arange(len(top))
    index[rest] = np.arange(len(rest)) - node_first[by_node[rest]]
    if layout is Layout.BOXES and len(top) > _TOP_NODES_MAX:
        raise ValueError(f"a cut leaves {len(top):,} resident nodes, more than {_TOP_NODES_MAX:,}")

    run_order, run_first, triangle_first = _moved_runs(links, by_node, treelet_count)
    words = with_links(layout, nodes, links, index, run_first, is_large_root | (is_resident & (by_node >= 0)))
    treelet_root = np.empty(treelet_count, np.int32)
    roots = top[by_node[top] >= 0]
    treelet_root[by_node[roots]] = index[roots]
    treelet_large = np.empty(treelet_count, np.int32)
    treelet_large[by_node[roots]] = in_large[roots]
    triangle_order = ranges(links.run_first[run_order], links.run_count[run_order])
    return Cut(
        layout=layout,
        top_nodes=words(top),
        top_treelet=by_node[top],
        treelet_root=treelet_root,
        nodes=words(rest),
        node_first=node_first,
        triangle_order=triangle_order if steps == 1 else _over_steps(triangle_order, triangle_first, steps),
        triangle_first=steps * triangle_first,
        levels=levels,
        top_large=np.where(is_large_root[top], in_large[top], np.int32(-1)),
        treelet_large=treelet_large,
        steps=steps,
    )


def _over_steps(order: np.ndarray, first: np.ndarray, steps: int) -> np.ndarray:
    """`order` of the units of one step, whose treelets begin at `first`, for those of all steps: block by block, and in
    each step by step.
    """
    count = np.diff(first, prepend=0)  # of the resident ones and of each treelet
    block = np.repeat(np.arange(len(count)), count)
    at = np.arange(len(order)) + (steps - 1) * (first - count)[block]
    out = np.empty(steps * len(order), np.int64)
    for step in range(steps):
        out[at + step * count[block]] = order + step * len(order)
    return out


def _opened(
    layout: Layout,
    nodes: np.ndarray,
    rule: CutRule,
    order: Order,
    size: np.ndarray,
    below: np.ndarray,
    units: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes are opened, and which are resident, in breadth-first order."""
    node_bytes, unit_bytes = 4 * layout.node_words, 4 * layout.triangle_words
    child_count = np.diff(order.child_first)
    if rule.size or rule.bytes_max:
        opened = np.zeros(len(size), bool)
        if rule.size:
            opened |= size > rule.size
        if rule.bytes_max:
            opened |= node_bytes * size + unit_bytes * below > rule.bytes_max
    else:
        opened = np.full(len(size), rule.top_bytes_max > 0)
    opened &= child_count > 0
    if rule.size_min > 1:
        small = ends_of(size < rule.size_min)
        opened &= small[order.child_first[1:]] == small[order.child_first[:-1]]
    levels = order.levels()
    if rule.depth_max < len(levels):
        opened[levels[rule.depth_max][0] :] = False
    resident = _close(order, opened)
    if rule.top_bytes_max:
        # A box is not larger than its parent's but for rounding: with the least on the way, a parent comes before its
        # children
        area = np.zeros(len(size))
        at = np.flatnonzero(opened)
        area[at] = node_areas(layout, nodes, order.node[at])
        for first, end in levels[:-1]:
            children = slice(int(order.child_first[first]), int(order.child_first[end]))
            area[children] = np.minimum(area[children], order.inherit(area[first:end], first, end))
        at = at[np.argsort(-area[at], kind="stable")]
        needed = node_bytes + np.cumsum(node_bytes * child_count[at] + unit_bytes * units[at])
        opened[at[np.searchsorted(needed, rule.top_bytes_max, side="right") :]] = False
        resident = _close(order, opened)
    return opened, resident


def _large(order: Order, opened: np.ndarray, bytes_below: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes are roots of large treelets, and the large treelet that each node is in, int32, or -1; both in
    breadth-first order. `bytes_below`: of each node's subtree.
    """
    large = np.full(len(opened), -1, np.int32)
    if not most:
        return np.zeros(len(opened), bool), large
    above = opened & (bytes_below > most)
    above[0] = opened[0]
    roots = _close(order, above) & ~above & opened
    large[roots] = np.arange(np.count_nonzero(roots), dtype=np.int32)
    for first, end in order.levels()[:-1]:
        children = slice(int(order.child_first[first]), int(order.child_first[end]))
        large[children] = np.maximum(large[children], order.inherit(large[first:end], first, end))
    return roots, large


def _close(order: Order, opened: np.ndarray) -> np.ndarray:
    """Close, in place, what is below a node that is not opened; returns which nodes are resident."""
    resident = np.ones(len(opened), bool)
    for first, end in order.levels()[:-1]:
        opened[first:end] &= resident[first:end]
        resident[order.child_first[first] : order.child_first[end]] = order.inherit(opened[first:end], first, end)
    last = int(order.level_first[-2])
    opened[last:] = False
    return resident


def _treelets(order: Order, opened: np.ndarray, resident: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, int]:
    """The treelet of each node (-1 for opened ones), int32, in breadth-first order, and the levels of resident
    nodes.
    """
    # position of each resident node in depth-first order: behind its parent and what is below earlier siblings
    rank = np.zeros(len(size), np.int64)
    before = ends_of(size)
    levels = order.levels()
    resident_levels = 1
    for level, (first, end) in enumerate(levels[:-1]):
        if not opened[first:end].any():
            break
        resident_levels = level + 2
        low, high = order.child_first[first], order.child_first[end]
        rank[low:high] = (
            order.inherit(rank[first:end] + 1 - before[order.child_first[first:end]], first, end) + before[low:high]
        )
    roots = np.flatnonzero(resident & ~opened)
    treelet = np.full(len(size), -1, np.int32)
    treelet[roots[np.argsort(rank[roots])]] = np.arange(len(roots))
    for first, end in levels[:-1]:
        children = slice(int(order.child_first[first]), int(order.child_first[end]))
        treelet[children] = np.where(
            resident[children], treelet[children], order.inherit(treelet[first:end], first, end)
        )
    return treelet, resident_levels


def _moved_runs(links: Links, by_node: np.ndarray, treelet_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The runs in their new order, the new first unit of each in its block, and where the treelets' units begin."""
    first, count = links.run_first, links.run_count
    by_unit = np.arange(len(first)) if (np.diff(first) > 0).all() else np.argsort(first, kind="stable")
    ends = ends_of(count[by_unit])
    if (first[by_unit] != ends[:-1]).any():
        raise ValueError("leaves do not list every triangle once")
    owner = by_node[links.run_node[by_unit]] + 1  # 0: resident
    run_order = by_unit[_stable_order(owner)]
    unit_first = ends_of(np.bincount(owner, count[by_unit], treelet_count + 1).astype(np.int64))
    moved = np.empty(len(first), np.int64)
    moved[run_order] = ends_of(count[run_order])[:-1]
    moved -= unit_first[by_node[links.run_node] + 1]
    return run_order, moved, unit_first[1:]


def _stable_order(keys: np.ndarray) -> np.ndarray:
    """Indices in the order of `keys`, those with equal keys in their own order."""
    if len(keys) and keys.max() < 1 << 16:
        keys = keys.astype(np.uint16)  # for which NumPy has a radix sort
    return np.argsort(keys, kind="stable")
