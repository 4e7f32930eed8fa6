"""The cut of a mesh tree into a few resident nodes and treelets.

A *treelet* is a subtree that is visited as a unit. Its root is resident; the nodes and triangles below the root form two
blocks, whose indices, the root's too, are relative to the block's first. What is above the treelets is resident:
*opened* nodes, with the triangles of their leaves. So every resident node is either opened or the root of a treelet.

Words are those of an uncut tree (`node.py`) with other indices: QUANTISED children stay contiguous in the order of slots, and
a node's triangles stay contiguous and in their order, so that `meta` bytes hold as they are. In BOXES a child that is the root of a
treelet is marked with `TREELET_CHILD`, in QUANTISED only a table by node tells (`Cut.top_treelet`).

The cut follows MIN_TREELETSIZE, TREELETSIZE and BVH_MAXDEPTH of the thesis (section 3.2), and besides a limit in bytes
and one for what is resident, which opens nodes by surface area: what rays meet most often. Nothing here depends on the
order in which nodes lie. Loops run over levels only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, WIDTH, Layout, aligned_empty

TREELET_CHILD = 0x40000000
"""BOXES: this bit of a resident node's child word says that the child is the root of a treelet. `EMPTY_CHILD` has it too."""

_TOP_NODES_MAX = TREELET_CHILD  # of BOXES, by that bit
_BYTES = np.arange(256)
_BIT_COUNT = sum(_BYTES >> bit & 1 for bit in range(8)).astype(np.uint8)
# QUANTISED: triangles that a meta byte says; 0 for an inner node (place 24 .. 31, count 1) and nothing
_META_TRIANGLES = np.where(_BYTES & 0xF8 == 0x38, 0, _BIT_COUNT[_BYTES >> 5]).astype(np.uint8)
_AREA_SLICE = 1 << 17  # nodes whose boxes are decoded at a time


@dataclass(frozen=True)
class CutRule:
    """Where a tree is cut. A node without inner children is never opened; the root's depth is 0.

    A rule that limits neither `size` nor `bytes_max` nor `top_bytes_max` makes one treelet. With `top_bytes_max` alone every
    node may be opened.
    """

    size: int = 0
    """Most nodes of a treelet, its root among them; 0: no limit."""
    size_min: int = 1
    """A node is not opened if the subtree of an inner child has fewer nodes (the thesis's rule), however large it is itself."""
    depth_max: int = 64
    """A node this deep is a treelet whatever its size."""
    bytes_max: int = 0
    """Most bytes of a treelet's nodes and triangles, its root among them; 0: no limit. A node that is larger by itself stays so."""
    top_bytes_max: int = 0
    """Nodes are opened from the largest surface area on, until resident nodes and triangles would take more bytes; 0: no limit."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"{name} of a cut is {value}, and must be 0 or more")


@dataclass(frozen=True)
class Cut:
    """A mesh tree that was cut. Units are triangles (QUANTISED) or groups of triangles (BOXES).

    Treelets are numbered in depth-first order of their roots: neighbours in number are neighbours in space.
    """

    layout: Layout
    top_nodes: np.ndarray  # words of the resident nodes, shape [n_top, words]; the root first, children after their parents
    top_treelet: np.ndarray  # int32, shape [n_top]: treelet whose root this is, or -1
    treelet_root: np.ndarray  # int32, shape [T]: place among `top_nodes`
    nodes: np.ndarray  # words below the roots, shape [m, words], one treelet after another
    node_first: np.ndarray  # int64, shape [T + 1]: where the treelets' nodes begin in `nodes`
    triangle_order: np.ndarray  # int64, shape [units]: old place of each unit: the resident ones, then treelet by treelet
    triangle_first: np.ndarray  # int64, shape [T + 1]: where the treelets' units begin in `triangle_order`
    levels: int  # levels of resident nodes, at least 1

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
        return 4 * (self.layout.node_words * self.treelet_sizes + self.layout.triangle_words * np.diff(self.triangle_first))

    @property
    def top_triangle_count(self) -> int:
        """Units that are resident."""
        return int(self.triangle_first[0])


class _Links(NamedTuple):
    """What nodes point to, without their boxes. A run is a leaf (BOXES) or all leaves of a node (QUANTISED)."""

    count: np.ndarray  # int64, shape [n]: inner children of each node
    children: np.ndarray  # int64: they themselves, node after node, in the order of slots
    run_node: np.ndarray  # int64, shape [runs]: node that holds the run
    run_slot: np.ndarray | None  # BOXES: and its slot
    run_first: np.ndarray  # int64: first unit
    run_count: np.ndarray  # int64: units


class _Order(NamedTuple):
    """A tree in breadth-first order, where the children of a node are contiguous and a level is too."""

    node: np.ndarray  # int64, shape [n]: its place in the block
    level_first: np.ndarray  # int64: first place of each level, then n
    child_first: np.ndarray  # int64, shape [n + 1]: children of i are places child_first[i] .. child_first[i + 1]

    def levels(self) -> list[tuple[int, int]]:
        """First and end of each level."""
        return list(zip(self.level_first[:-1].tolist(), self.level_first[1:].tolist(), strict=True))

    def totals(self, own: np.ndarray) -> np.ndarray:
        """Sums of `own`, int64, over the subtree of each node."""
        total = own.copy()
        for first, end in self.levels()[-2::-1]:
            children = self.child_first[first : end + 1]
            below = _ends(total[children[0] : children[-1]])[children - children[0]]
            total[first:end] += np.diff(below)
        return total

    def inherit(self, values: np.ndarray, first: int, end: int) -> np.ndarray:
        """For each child of the places first .. end, which have `values`, that of its parent."""
        return np.repeat(values, np.diff(self.child_first[first : end + 1]))


def tree_levels(layout: Layout, nodes: np.ndarray) -> list[np.ndarray]:
    """Nodes that are reached from node 0, int64, level by level; more may lie behind them. Raises `ValueError` for a cycle."""
    links = _links(layout, nodes)
    return _levels(links.count, links.children)


def cut_nodes(layout: Layout, nodes: np.ndarray, rule: CutRule) -> Cut:
    """Cut the tree whose words are `nodes`, shape [n, words of a node]; they are left as they are.

    Raises `ValueError` where they are not one tree, or its leaves do not list every unit once.
    """
    nodes = np.ascontiguousarray(nodes)
    links = _links(layout, nodes)
    order = _breadth_first(links)
    units = np.bincount(links.run_node, links.run_count, len(nodes)).astype(np.int64)[order.node]
    size, below = order.totals(np.ones(len(nodes), np.int64)), order.totals(units)
    opened, resident = _opened(layout, nodes, rule, order, size, below, units)
    treelet_at, levels = _treelets(order, opened, resident, size)

    by_node = np.empty(len(nodes), np.int32)
    by_node[order.node] = treelet_at  # treelet that a node is in, its root included; -1 for opened nodes
    is_resident = np.empty(len(nodes), bool)
    is_resident[order.node] = resident
    top = np.flatnonzero(is_resident)
    rest = np.flatnonzero(~is_resident)
    treelet_count = int(treelet_at.max()) + 1
    if treelet_count > 1:
        rest = rest[_stable_order(by_node[rest])]
    node_first = _ends(np.bincount(by_node[rest], minlength=treelet_count))
    place = np.empty(len(nodes), np.int32)
    place[top] = np.arange(len(top))
    place[rest] = np.arange(len(rest)) - node_first[by_node[rest]]
    if layout is Layout.BOXES and len(top) > _TOP_NODES_MAX:
        raise ValueError(f"a cut leaves {len(top):,} resident nodes, more than {_TOP_NODES_MAX:,}")

    run_order, run_place, triangle_first = _moved_runs(links, by_node, treelet_count)
    words = _with_links(layout, nodes, links, place, run_place, is_resident & (by_node >= 0))
    treelet_root = np.empty(treelet_count, np.int32)
    roots = top[by_node[top] >= 0]
    treelet_root[by_node[roots]] = place[roots]
    return Cut(
        layout=layout,
        top_nodes=words(top),
        top_treelet=by_node[top],
        treelet_root=treelet_root,
        nodes=words(rest),
        node_first=node_first,
        triangle_order=_ranges(links.run_first[run_order], links.run_count[run_order]),
        triangle_first=triangle_first,
        levels=levels,
    )


def _links(layout: Layout, nodes: np.ndarray) -> _Links:
    if layout is Layout.BOXES:
        child = nodes.view(BOXES_NODE)[:, 0]["child"].copy()  # together: each is looked at many times
        inner = (child >= 0) & (child != EMPTY_CHILD)
        run_node, run_slot = np.nonzero(child < 0)
        code = ~child[run_node, run_slot].astype(np.int64)
        return _Links(inner.sum(1), child[inner].astype(np.int64), run_node, run_slot, code >> 3, (code & 7) + 1)
    fields = nodes.view(QUANTISED_NODE)[:, 0]
    count = _BIT_COUNT[fields["inner_mask"]].astype(np.int64)
    units = _META_TRIANGLES[fields["meta"]].sum(1, dtype=np.int64)
    run_node = np.flatnonzero(units)
    first = fields["triangle_base"][run_node].astype(np.int64)
    return _Links(count, _ranges(fields["child_base"].astype(np.int64), count), run_node, None, first, units[run_node])


def _levels(count: np.ndarray, children: np.ndarray) -> list[np.ndarray]:
    first, level = _ends(count), np.zeros(1, np.int64)
    found, total = [], 0
    while len(level):
        total += len(level)
        if total > len(count):
            raise ValueError("a node is reached twice")
        found.append(level)
        level = children[_ranges(first[level], count[level])]
        if len(level) and not 0 < level.min() <= level.max() < len(count):
            raise ValueError("a child lies outside of the block")
    return found


def _breadth_first(links: _Links) -> _Order:
    levels = _levels(links.count, links.children)
    node = np.concatenate(levels)
    if len(node) != len(links.count) or (np.bincount(node, minlength=len(node)) != 1).any():
        raise ValueError("a node is never reached, or twice")
    return _Order(node, _ends(np.array([len(level) for level in levels])), 1 + _ends(links.count[node]))


def _opened(
    layout: Layout, nodes: np.ndarray, rule: CutRule, order: _Order, size: np.ndarray, below: np.ndarray, units: np.ndarray
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
        small = _ends(size < rule.size_min)
        opened &= small[order.child_first[1:]] == small[order.child_first[:-1]]
    levels = order.levels()
    if rule.depth_max < len(levels):
        opened[levels[rule.depth_max][0] :] = False
    resident = _close(order, opened)
    if rule.top_bytes_max:
        # A box is not larger than its parent's but for rounding: with the least on the way, a parent comes before its children
        area = np.zeros(len(size))
        at = np.flatnonzero(opened)
        area[at] = _areas(layout, nodes, order.node[at])
        for first, end in levels[:-1]:
            children = slice(int(order.child_first[first]), int(order.child_first[end]))
            area[children] = np.minimum(area[children], order.inherit(area[first:end], first, end))
        at = at[np.argsort(-area[at], kind="stable")]
        needed = node_bytes + np.cumsum(node_bytes * child_count[at] + unit_bytes * units[at])
        opened[at[np.searchsorted(needed, rule.top_bytes_max, side="right") :]] = False
        resident = _close(order, opened)
    return opened, resident


def _close(order: _Order, opened: np.ndarray) -> np.ndarray:
    """Close, in place, what is below a node that is not opened; returns which nodes are resident."""
    resident = np.ones(len(opened), bool)
    for first, end in order.levels()[:-1]:
        opened[first:end] &= resident[first:end]
        resident[order.child_first[first] : order.child_first[end]] = order.inherit(opened[first:end], first, end)
    last = int(order.level_first[-2])
    opened[last:] = False
    return resident


def _areas(layout: Layout, nodes: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Half the surface areas of the boxes of `which` nodes, float64."""
    areas = np.empty(len(which))
    for first in range(0, len(which), _AREA_SLICE):
        part = nodes[which[first : first + _AREA_SLICE]]
        if layout is Layout.BOXES:
            planes = part.view(BOXES_NODE)[:, 0]["planes"].astype(np.float64)
            extent = planes[:, :, 1].max(2) - planes[:, :, 0].min(2)
        else:
            fields = part.view(QUANTISED_NODE)[:, 0]
            there = (fields["meta"] != 0)[:, None]
            steps = np.where(there, fields["high"], 0).max(2).astype(np.float64) - np.where(there, fields["low"], 255).min(2)
            extent = np.exp2(fields["exponent"].astype(np.float64) - 127) * steps
        areas[first : first + _AREA_SLICE] = extent[:, 0] * extent[:, 1] + extent[:, 1] * extent[:, 2] + extent[:, 2] * extent[:, 0]
    return areas


def _treelets(order: _Order, opened: np.ndarray, resident: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, int]:
    """The treelet of each node (-1 for opened ones), int32, in breadth-first order, and the levels of resident nodes."""
    # place of each resident node in depth-first order: behind its parent and what is below earlier siblings
    rank = np.zeros(len(size), np.int64)
    before = _ends(size)
    levels = order.levels()
    resident_levels = 1
    for level, (first, end) in enumerate(levels[:-1]):
        if not opened[first:end].any():
            break
        resident_levels = level + 2
        low, high = order.child_first[first], order.child_first[end]
        rank[low:high] = order.inherit(rank[first:end] + 1 - before[order.child_first[first:end]], first, end) + before[low:high]
    roots = np.flatnonzero(resident & ~opened)
    treelet = np.full(len(size), -1, np.int32)
    treelet[roots[np.argsort(rank[roots])]] = np.arange(len(roots))
    for first, end in levels[:-1]:
        children = slice(int(order.child_first[first]), int(order.child_first[end]))
        treelet[children] = np.where(resident[children], treelet[children], order.inherit(treelet[first:end], first, end))
    return treelet, resident_levels


def _moved_runs(links: _Links, by_node: np.ndarray, treelet_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The runs in their new order, the new place of each in its block, and where the treelets' units begin."""
    first, count = links.run_first, links.run_count
    by_place = np.arange(len(first)) if (np.diff(first) > 0).all() else np.argsort(first, kind="stable")
    ends = _ends(count[by_place])
    if (first[by_place] != ends[:-1]).any():
        raise ValueError("leaves do not list every triangle once")
    owner = by_node[links.run_node[by_place]] + 1  # 0: resident
    run_order = by_place[_stable_order(owner)]
    unit_first = _ends(np.bincount(owner, count[by_place], treelet_count + 1).astype(np.int64))
    place = np.empty(len(first), np.int64)
    place[run_order] = _ends(count[run_order])[:-1]
    place -= unit_first[by_node[links.run_node] + 1]
    return run_order, place, unit_first[1:]


def _with_links(layout: Layout, nodes: np.ndarray, links: _Links, place: np.ndarray, run_place: np.ndarray, is_root: np.ndarray):
    """A function that gives the words of nodes with new places for children and units."""
    if layout is Layout.BOXES:
        child = nodes.view(BOXES_NODE)[:, 0]["child"].copy()
        inner = (child >= 0) & (child != EMPTY_CHILD)
        child[inner] = place[links.children] | np.where(is_root[links.children], TREELET_CHILD, 0).astype(np.int32)
        child[links.run_node, links.run_slot] = ~(run_place * WIDTH + links.run_count - 1)
        moved = {"child": child}
    else:
        base = np.zeros(len(nodes), np.int32)  # of nodes without inner children, or without triangles, 0
        has = links.count > 0
        base[has] = place[links.children[_ends(links.count)[:-1][has]]]
        triangle = np.zeros(len(nodes), np.int32)
        triangle[links.run_node] = run_place
        moved = {"child_base": base, "triangle_base": triangle}

    def words(which: np.ndarray) -> np.ndarray:
        out = aligned_empty((len(which), layout.node_words), layout.node_type)
        np.take(nodes, which, axis=0, out=out, mode="clip")  # any other mode makes a copy first
        fields = out.view(BOXES_NODE if layout is Layout.BOXES else QUANTISED_NODE)[:, 0]
        for name, values in moved.items():
            fields[name] = values[which]
        return out

    return words


def _ends(counts: np.ndarray) -> np.ndarray:
    """0, then the sums of all counts up to each, int64."""
    ends = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=ends[1:])
    return ends


def _ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """first[0] .. first[0] + count[0] - 1, then those of the next, int64."""
    ends = _ends(count)
    return np.repeat(first - ends[:-1], count) + np.arange(ends[-1])


def _stable_order(keys: np.ndarray) -> np.ndarray:
    """Places by key, those with equal keys in their order."""
    if len(keys) and keys.max() < 1 << 16:
        keys = keys.astype(np.uint16)  # for which NumPy has a radix sort
    return np.argsort(keys, kind="stable")
