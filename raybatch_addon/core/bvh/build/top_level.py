"""The top level of a scene, a tree over its entries; where these move, one for each of some ranges of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp

from ...device.bulk import in_slices
from ...native.structs import to_numpy
from ..margin import SLAB_MARGIN
from ..node import BOXES_NODE, QUANTISED_NODE, Layout, half_areas
from ..tree import Tree
from .binary import BuildOptions
from .collapse import TOP_COST, collapse_entries
from .cpu.build import build_binary_from_boxes
from .cuda.build import build_top
from .encode import as_vectors
from .entries import Entries
from .mesh_ranges import MeshRanges
from .time_ranges import RANGE_GAIN_LEAST, RANGES_MOST, best_count, bounds

# Entries whose boxes a thread works on together
_IN_A_THREAD = 1 << 16
# Of the entries that change at most so many say how many ranges are worth it
_LOOKED_AT = 1024
# What an entry takes in a top level, about: 20,000 took 58 bytes each in the layout BOXES
_ENTRY_BYTES = 64


class TopLevel(NamedTuple):
    """The trees over entries, one for each range of time."""

    nodes: wp.array  # vec4, in the layout of the mesh trees, tree behind tree
    order: wp.array  # int: entries as leaves list them, those of each tree behind those before
    first: list[int]  # first node of each tree, then their count
    centre: np.ndarray  # float32 [trees, 3]: what box coordinates are relative to
    margin: float  # of rays, as `Tree.top_margin`

    def place(self, tree: Tree, first: int, device: wp.Device) -> None:
        """Make `tree` one whose nodes have these from `first` on, in which things move or not."""
        tree.top_node, tree.top_entry = first, self.order
        tree.top_centre, tree.top_margin = wp.vec3(*self.centre[0].tolist()), self.margin
        if tree.motion_steps:
            tree.top_ranges = len(self.centre)
            tree.range_node = wp.array(
                np.array([first + each for each in self.first[:-1]], np.int32), dtype=int, device=device
            )
            tree.range_centre = wp.array(self.centre, dtype=wp.vec3, device=device)


@dataclass(frozen=True)
class Listed:
    """Entries as traversal knows them. One whose mesh tree has nodes for ranges of time is there for each of these."""

    source: np.ndarray  # which of `Entries` each is
    range: np.ndarray  # of its mesh, 0 where that has one
    of_range: list[np.ndarray]  # by range of the top level: which is there, of each of `Entries`

    @staticmethod
    def of(mesh: np.ndarray, mesh_ranges: np.ndarray, count: int) -> Listed:
        """Of entries over the meshes `mesh`, which have so many ranges each, below `count` top levels."""
        own = mesh_ranges[mesh]
        more = np.repeat(np.arange(len(mesh)), own - 1)
        first = len(mesh) + np.cumsum(own - 1) - (own - 1)  # the first further one of each
        further = 1 + np.arange(len(more)) - np.repeat(first - len(mesh), own - 1)
        here = [own * k // count for k in range(count)]
        return Listed(
            np.concatenate([np.arange(len(mesh)), more]),
            np.concatenate([np.zeros(len(mesh), np.int64), further]),
            [np.where(at > 0, first + at - 1, np.arange(len(mesh))) for at in here],
        )


class OverTime:
    """The entries of a scene at all times: their boxes, and how many ranges of time their top level is worth."""

    def __init__(self, entries: Entries, mesh_box: np.ndarray, mesh_cost: np.ndarray, deforms: np.ndarray):
        """Entries over mesh trees with these boxes, shape [m, 2, 3], and costs (`MeshTree.sah`), of which some deform:
        bool, shape [m].
        """
        self._entries, self._mesh_box, self._mesh_cost = entries, mesh_box, mesh_cost
        self.meshes: dict[int, list[MeshRanges]] = {}  # of those that deform: 1, 2, 4, ... ranges (`worthwhile`)
        self.whole = entries.boxes(mesh_box)  # world boxes of all that entries come by, as `boxes`
        self._changes = np.flatnonzero(deforms[entries.mesh] | entries.moving())

    def chosen(self, count: int) -> dict[int, MeshRanges]:
        """The ranges of the meshes that have more than one below `count` top levels."""
        found = {i: each[min(count.bit_length(), len(each)) - 1] for i, each in self.meshes.items()}
        return {i: each for i, each in found.items() if each.count > 1}

    def boxes(self, index: int, count: int) -> np.ndarray:
        """World boxes of all entries in range `index` of `count`, float64, shape [n, 2, 3]."""
        return self.whole if count == 1 else self._entries.boxes(self._at(index, count)[0], *bounds(index, count))

    def may_pay(self) -> bool:
        """Whether ranges would pay if nothing were left of what changes."""
        still, changing = self._whole_costs()
        return changing > RANGE_GAIN_LEAST * (still + changing)

    def count(self, room: int) -> int:
        """The number of ranges that pays: from the areas of boxes and the costs of the trees in them; as many as do
        not need more than `room` [bytes], about.
        """
        still, changing = self._whole_costs()
        some = self._changes[:: max(1, -(-len(self._changes) // _LOOKED_AT))]
        whole = self._costs(self.whole[some], self._mesh_cost, some).sum()
        if not (self.may_pay() and whole > 0):
            return 1
        costs, count = [still + changing], 2
        while count <= RANGES_MOST and count * len(self.whole) * _ENTRY_BYTES <= room:
            share = sum(self._cost_in(k, count, some) for k in range(count)) / (count * whole)
            costs.append(still + share * changing)
            count *= 2
        return best_count(costs)

    def _whole_costs(self) -> tuple[float, float]:
        """What a ray's steps cost with one range: above and in what does not change, and in what does."""
        if not len(self._changes):
            return 1.0, 0.0
        cost = self._costs(self.whole, self._mesh_cost, slice(None))
        changing = float(cost[self._changes].sum())
        top = float(half_areas(self.whole[:, 1].max(0) - self.whole[:, 0].min(0)))
        return top + float(cost.sum()) - changing, changing

    def _at(self, index: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Boxes and costs of the mesh trees in a range."""
        box, cost = self._mesh_box.copy(), self._mesh_cost.copy()
        for i, ranges in self.chosen(count).items():
            at = index * ranges.count // count
            box[i], cost[i] = ranges.box[at], ranges.sah[at]
        return box, cost

    def _cost_in(self, index: int, count: int, some: np.ndarray) -> float:
        """The expected steps of a ray in the entries `some`, in a range."""
        box, cost = self._at(index, count)
        return self._costs(self._entries.boxes(box, *bounds(index, count), some), cost, some).sum()

    def _costs(self, boxes: np.ndarray, cost: np.ndarray, which: np.ndarray | slice) -> np.ndarray:
        return half_areas(boxes[:, 1] - boxes[:, 0]) * (TOP_COST.unit + cost[self._entries.mesh[which]])


def build_top_level(
    entries: Entries,
    boxes: Sequence[np.ndarray],
    layout: Layout,
    device: wp.Device,
    listed: Sequence[np.ndarray] | None = None,
) -> TopLevel:
    """The trees over `entries`, whose world boxes in each range of time are `boxes`; their arrays are on `device`.

    `listed`: by range the numbers of the entries that are there, as `Listed.of_range`.

    Let x -> M x + m be the entry's map from the world, A the inverse of M, |M| the largest sum of a row's sizes, and R
    the largest coordinate of the entry's box or of its origin. A ray that is carried to object space by nine products
    and sums of float32 is wrong there by at most 8u |M| (|o| + R), the rounding of M and m adds as much again, and the
    triangle test 19u of the largest object coordinate (`margin.py`), which is below |M| (|o| + R) too. A carries any of
    these into any axis of the world: together they are below 2 `SLAB_MARGIN` |A| |M| (|o| + R) there. An uneven scale
    makes |A| |M| large.
    """
    condition, origins = entries.conditions()
    ray_margin = float(2 * SLAB_MARGIN * condition.max())
    trees = [_tree_over(each, condition, origins, layout, device) for each in boxes]
    centre = np.stack([centre for _, _, centre in trees])
    if len(trees) == 1 and listed is None:
        nodes, order, _ = trees[0]
        return TopLevel(nodes, order, [0, nodes.size * 4 // layout.node_words], centre, ray_margin)
    words, orders, first, behind = [], [], [0], 0
    for i, (nodes, order, _) in enumerate(trees):
        own = to_numpy(nodes).view(layout.node_type).reshape(-1, layout.node_words)
        words.append(_shifted(layout, own, behind))
        numbers = to_numpy(order)
        orders.append(numbers if listed is None else listed[i][numbers])
        first.append(first[-1] + len(own))
        behind += len(numbers)
    joined = np.concatenate(words)
    nodes = (
        wp.array(joined.view(np.float32).reshape(-1, 4), dtype=wp.vec4, device=device)
        if device.is_cuda
        else as_vectors(joined)
    )
    order = wp.array(np.concatenate(orders).astype(np.int32), dtype=int, device=device)
    return TopLevel(nodes, order, first, centre, ray_margin)


def _tree_over(
    boxes: np.ndarray, condition: np.ndarray, origins: np.ndarray, layout: Layout, device: wp.Device
) -> tuple[wp.array, wp.array, np.ndarray]:
    """Nodes, order and centre of one tree."""
    low, high = np.empty((len(boxes), 3), np.float32), np.empty((len(boxes), 3), np.float32)
    # no coordinate of the top level's centre is larger than all boxes
    most = max(abs(boxes.min()), abs(boxes.max()))

    def widen(part: slice) -> None:
        some = boxes[part]
        reach = np.maximum(np.abs(some).max((1, 2)), origins[part]) + most
        margin = (2 * SLAB_MARGIN * condition[part] * reach)[:, None]
        low[part] = np.nextafter((some[:, 0] - margin).astype(np.float32), np.float32(-np.inf))
        high[part] = np.nextafter((some[:, 1] + margin).astype(np.float32), np.float32(np.inf))

    in_slices(len(boxes), widen, _IN_A_THREAD)
    if device.is_cuda:
        top = build_top(wp.array(low, dtype=wp.vec3, device=device), wp.array(high, dtype=wp.vec3, device=device))
        return top.nodes, top.order, top.centre
    top = collapse_entries(build_binary_from_boxes(low, high, BuildOptions(leaf_group=1, leaf_max=1)), layout)
    return as_vectors(top.nodes), wp.array(top.order, dtype=int, device=device), top.centre


def _shifted(layout: Layout, words: np.ndarray, behind: int) -> np.ndarray:
    """The nodes `words` with leaves that list entries `behind` so many others."""
    shifted = words.copy()
    if layout is Layout.BOXES:
        child = shifted.view(BOXES_NODE)[:, 0]["child"]
        child[child < 0] -= 8 * behind
    else:
        shifted.view(QUANTISED_NODE)[:, 0]["triangle_base"] += behind
    return shifted
