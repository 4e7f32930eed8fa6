"""The links of a wide tree, read from either layout: children of nodes, units of leaves, breadth-first order; and nodes
written with other links.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, WIDTH, Layout, aligned_empty, half_areas

TREELET_CHILD = 0x40000000
"""BOXES: this bit of a resident node's child word says that the child is the root of a treelet. `EMPTY_CHILD` has it
too.
"""

_BYTES = np.arange(256)
_BIT_COUNT = (_BYTES[:, None] >> np.arange(8) & 1).sum(1).astype(np.uint8)
# QUANTISED: triangles of a leaf by its meta byte; 0 for an inner node (offset 24 .. 31, count 1) and an empty slot
_META_TRIANGLES = np.where(_BYTES & 0xF8 == 0x38, 0, _BIT_COUNT[_BYTES >> 5]).astype(np.uint8)
_AREA_SLICE = 1 << 17  # nodes whose boxes are decoded at a time


@dataclass(frozen=True)
class Links:
    """The links of nodes, without their boxes. A run is a leaf (BOXES) or all leaves of a node (QUANTISED)."""

    count: np.ndarray  # int64, shape [n]: inner children of each node
    children: np.ndarray  # int64: the children, node after node, in the order of slots
    run_node: np.ndarray  # int64, shape [runs]: node that holds the run
    run_slot: np.ndarray | None  # BOXES: slot of the run in that node
    run_first: np.ndarray  # int64: first unit
    run_count: np.ndarray  # int64: units


class Order(NamedTuple):
    """A tree in breadth-first order: the children of a node are contiguous, and so is each level."""

    node: np.ndarray  # int64, shape [n]: index in the block of nodes
    level_first: np.ndarray  # int64: first position of each level, then n
    child_first: np.ndarray  # int64, shape [n + 1]: children of i are at child_first[i] .. child_first[i + 1]

    def levels(self) -> list[tuple[int, int]]:
        """First and end of each level."""
        return list(zip(self.level_first[:-1].tolist(), self.level_first[1:].tolist(), strict=True))

    def totals(self, own: np.ndarray) -> np.ndarray:
        """Sums of `own`, int64, over the subtree of each node."""
        total = own.copy()
        for first, end in self.levels()[-2::-1]:
            children = self.child_first[first : end + 1]
            below = ends_of(total[children[0] : children[-1]])[children - children[0]]
            total[first:end] += np.diff(below)
        return total

    def inherit(self, values: np.ndarray, first: int, end: int) -> np.ndarray:
        """The value of its parent for each child of the nodes at first .. end, whose values are `values`."""
        return np.repeat(values, np.diff(self.child_first[first : end + 1]))


def tree_levels(layout: Layout, nodes: np.ndarray) -> list[np.ndarray]:
    """Nodes that are reached from node 0, int64, level by level; more may lie behind them. Raises `ValueError` for a
    cycle.
    """
    links = links_of(layout, nodes)
    return levels_of(links.count, links.children)


def links_of(layout: Layout, nodes: np.ndarray) -> Links:
    """The links in the words of `nodes`, shape [n, words]."""
    if layout is Layout.BOXES:
        child = nodes.view(BOXES_NODE)[:, 0]["child"].copy()  # together: each is looked at many times
        inner = (child >= 0) & (child != EMPTY_CHILD)
        run_node, run_slot = np.nonzero(child < 0)
        code = ~child[run_node, run_slot].astype(np.int64)
        return Links(inner.sum(1), child[inner].astype(np.int64), run_node, run_slot, code >> 3, (code & 7) + 1)
    fields = nodes.view(QUANTISED_NODE)[:, 0]
    count = _BIT_COUNT[fields["inner_mask"]].astype(np.int64)
    units = _META_TRIANGLES[fields["meta"]].sum(1, dtype=np.int64)
    run_node = np.flatnonzero(units)
    first = fields["triangle_base"][run_node].astype(np.int64)
    return Links(count, ranges(fields["child_base"].astype(np.int64), count), run_node, None, first, units[run_node])


def levels_of(count: np.ndarray, children: np.ndarray) -> list[np.ndarray]:
    """The levels of `tree_levels`, from `Links.count` and `Links.children`."""
    first, level = ends_of(count), np.zeros(1, np.int64)
    found, total = [], 0
    while len(level):
        total += len(level)
        if total > len(count):
            raise ValueError("a node is reached twice")
        found.append(level)
        level = children[ranges(first[level], count[level])]
        if len(level) and not 0 < level.min() <= level.max() < len(count):
            raise ValueError("a child lies outside of the block")
    return found


def breadth_first(links: Links) -> Order:
    """The breadth-first order of all nodes. Raises `ValueError` where they are not one tree."""
    levels = levels_of(links.count, links.children)
    node = np.concatenate(levels)
    if len(node) != len(links.count) or (np.bincount(node, minlength=len(node)) != 1).any():
        raise ValueError("a node is never reached, or twice")
    return Order(node, ends_of(np.array([len(level) for level in levels])), 1 + ends_of(links.count[node]))


def node_areas(layout: Layout, nodes: np.ndarray, which: np.ndarray) -> np.ndarray:
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
            steps = np.where(there, fields["high"], 0).max(2).astype(np.float64) - np.where(
                there, fields["low"], 255
            ).min(2)
            extent = np.exp2(fields["exponent"].astype(np.float64) - 127) * steps
        areas[first : first + _AREA_SLICE] = half_areas(extent)
    return areas


def with_links(
    layout: Layout, nodes: np.ndarray, links: Links, index: np.ndarray, run_first: np.ndarray, is_root: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """A function from nodes to their words with new links.

    Args:
        layout, nodes, links: the tree as it is.
        index: new index of each node, shape [n].
        run_first: new first unit of each run.
        is_root: nodes that become roots of treelets, bool, shape [n]; marked in BOXES.
    """
    if layout is Layout.BOXES:
        child = nodes.view(BOXES_NODE)[:, 0]["child"].copy()
        inner = (child >= 0) & (child != EMPTY_CHILD)
        child[inner] = index[links.children] | np.where(is_root[links.children], TREELET_CHILD, 0).astype(np.int32)
        child[links.run_node, links.run_slot] = ~(run_first * WIDTH + links.run_count - 1)
        moved = {"child": child}
    else:
        base = np.zeros(len(nodes), np.int32)  # of nodes without inner children, or without triangles, 0
        has = links.count > 0
        base[has] = index[links.children[ends_of(links.count)[:-1][has]]]
        triangle = np.zeros(len(nodes), np.int32)
        triangle[links.run_node] = run_first
        moved = {"child_base": base, "triangle_base": triangle}

    def words(which: np.ndarray) -> np.ndarray:
        out = aligned_empty((len(which), layout.node_words), layout.node_type)
        np.take(nodes, which, axis=0, out=out, mode="clip")  # any other mode makes a copy first
        fields = out.view(BOXES_NODE if layout is Layout.BOXES else QUANTISED_NODE)[:, 0]
        for name, values in moved.items():
            fields[name] = values[which]
        return out

    return words


def ends_of(counts: np.ndarray) -> np.ndarray:
    """0, then the sums of all counts up to each, int64."""
    ends = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=ends[1:])
    return ends


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """first[0] .. first[0] + count[0] - 1, then those of the next, int64."""
    ends = ends_of(count)
    return np.repeat(first - ends[:-1], count) + np.arange(ends[-1])
