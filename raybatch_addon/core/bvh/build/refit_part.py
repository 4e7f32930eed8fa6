"""A tree of BOXES for new positions of some of its triangles: what is not above these stays as it is.

A refit of the whole tree (`refit.py`) leaves the boxes that it joined; here those of the leaves that list a moved
triangle, and of the nodes above them, are joined anew, deepest nodes first, and written. A ball that rolls through
another million triangles touches a few hundred nodes of forty thousand.

The tree keeps its centre, which may be anywhere: margins count from it. So nodes are not those of a refit of the whole,
where the centre follows the box; hits are, as they do not depend on the tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..margin import SLAB_MARGIN
from ..node import BOXES_GROUP, BOXES_NODE, EMPTY_CHILD, WIDTH, half_areas
from .collapse import BOXES_COST, CollapseCost
from .refit import RefitResult

# Where so many triangles moved, or so many groups list one that did, the whole tree is as soon refitted
MOVED_SHARE_MOST = 0.2


def is_part(moved: Sequence[tuple[int, int]], triangle_count: int) -> bool:
    """Whether the triangles `moved`, first and count, of so many are few enough for `refit_part`."""
    return sum(count for _, count in moved) <= MOVED_SHARE_MOST * triangle_count


@dataclass
class WholeBoxes:
    """The boxes of whole triangles below each node of a tree, as its last refit left them, and what leads from
    triangles to nodes; kept as long as the topology.
    """

    boxes: np.ndarray  # float32, shape [node_count, 6]: low corner, high corner, absolute
    costs: np.ndarray  # float64, shape [node_count]: of each node and its leaves, times the root's area
    above: np.ndarray  # int32, shape [node_count]: the node that holds each; -1 for the root
    level: np.ndarray  # int32, shape [node_count]: 0 for the root
    holder: np.ndarray  # int32, shape [group_count]: the node whose leaf lists a group
    _moved: tuple[tuple[int, int], ...] = ()  # triangles that moved last: first and count
    _groups: np.ndarray | None = None  # that list them

    @staticmethod
    def of(boxes: np.ndarray, costs: np.ndarray, nodes: np.ndarray, group_count: int) -> WholeBoxes:
        """What `refit_boxes` found of the tree of `nodes`, float32, shape [n, 64]: `boxes` as here, and `costs` as part
        of its `sah`.
        """
        child, inner, count = _children(nodes)
        above = np.full(len(nodes), -1, np.int32)
        level = np.zeros(len(nodes), np.int32)
        holder = np.zeros(group_count, np.int32)
        holders, slots = np.nonzero(inner >= 0)
        above[inner[holders, slots]] = holders
        here, depth = np.zeros(1, np.int64), 0
        while len(here):
            level[here] = depth
            below = inner[here]
            here, depth = below[below >= 0], depth + 1
        for k in range(int(count.max(initial=0))):
            holders, slots = np.nonzero(count > k)
            holder[(~child[holders, slots] >> 3) + k] = holders
        return WholeBoxes(boxes, costs * _area(boxes[0]), above, level, holder)

    def groups_of(self, faces: np.ndarray, moved: Sequence[tuple[int, int]]) -> np.ndarray:
        """Groups that list a triangle of `moved`, of which each is a first triangle and a count.

        `faces`: the triangles of groups, int32, shape [g, 8], -1 for none.
        """
        if self._groups is None or self._moved != tuple(moved):
            is_moved = np.zeros(int(faces.max()) + 2, bool)  # the last is that of -1
            for first, count in moved:
                is_moved[first : first + count] = True
            self._moved, self._groups = tuple(moved), np.flatnonzero(is_moved[faces].any(1))
        return self._groups


def refit_part(
    nodes: np.ndarray,
    groups: np.ndarray,
    centre: np.ndarray,
    whole: WholeBoxes,
    moved: Sequence[tuple[int, int]],
    positions: np.ndarray,
    triangles: np.ndarray,
    cost: CollapseCost = BOXES_COST,
) -> RefitResult | None:
    """Refit a tree in place to new positions of the triangles `moved`; None where these are too many, or where it has
    no area: then the whole is to be refitted.

    Args:
        nodes, groups: float32, shape [n, 64] and [g, 80].
        centre: what its boxes are relative to, float32, shape [3].
        whole: its boxes, which are brought up to date.
        moved: first and count of triangles that moved, among the tree's.
        positions, triangles: vertices, float32, shape [v, 3], and the tree's triangles, int32, shape [t, 3].
        cost: weights for `sah`.
    """
    blocks = groups.view(BOXES_GROUP)[:, 0]
    changed = whole.groups_of(blocks["face"], moved)
    if len(changed) > MOVED_SHARE_MOST * len(groups):
        return None
    faces = blocks["face"][changed]
    corners = positions[triangles[faces]].transpose(0, 2, 3, 1)  # group, corner, axis, lane
    blocks["corners"][changed] = np.where(faces[:, None, None] < 0, np.float32(0), corners)
    touched = _with_those_above(whole, whole.holder[changed])
    child, inner, count = _children(nodes[touched])
    boxes = _leaf_boxes(child, count, blocks)
    ends = np.flatnonzero(np.diff(whole.level[touched])) + 1
    for part in np.split(np.arange(len(touched)), ends):  # a level, the deepest first
        rows, slots = np.nonzero(inner[part] >= 0)
        boxes[part[rows], slots] = whole.boxes[inner[part[rows], slots]]
        whole.boxes[touched[part], :3] = boxes[part, :, :3].min(1)
        whole.boxes[touched[part], 3:] = boxes[part, :, 3:].max(1)
    leaves = np.where(count > 0, _area(np.where(count[..., None] > 0, boxes, np.float32(0))) * count, 0.0).sum(1)
    whole.costs[touched] = _area(whole.boxes[touched]) * cost.node + leaves * cost.unit
    _write(nodes, touched, boxes, whole.boxes[touched], centre.astype(np.float64))
    area = float(_area(whole.boxes[0]))
    if area <= 0:
        return None
    return RefitResult(centre, whole.boxes[0].reshape(2, 3).copy(), float(whole.costs.sum()) / area)


def _with_those_above(whole: WholeBoxes, nodes: np.ndarray) -> np.ndarray:
    """`nodes` and all that hold them, each once, the deepest first."""
    found = [nodes := np.unique(nodes)]
    while len(nodes := np.unique(whole.above[nodes][whole.above[nodes] >= 0])):
        found.append(nodes)
    touched = np.unique(np.concatenate(found))
    return touched[np.argsort(-whole.level[touched], kind="stable")]


def _children(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Words of the children of `nodes`, int64, shape [n, 8]; those that are nodes, or -1; and how many groups leaves
    have.
    """
    child = nodes.view(BOXES_NODE)[:, 0]["child"].astype(np.int64)
    leaf = child < 0
    return child, np.where(leaf | (child == EMPTY_CHILD), -1, child), np.where(leaf, (~child & 7) + 1, 0)


def _leaf_boxes(child: np.ndarray, count: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Boxes around the whole triangles of leaves, float32, shape [n, 8, 6]; inside out where there is no leaf."""
    found = np.empty((*child.shape, 6), np.float32)
    found[..., :3], found[..., 3:] = np.inf, -np.inf
    for k in range(int(count.max(initial=0))):
        rows, slots = np.nonzero(count > k)
        listed = blocks[(~child[rows, slots] >> 3) + k]
        there = (listed["face"] >= 0)[:, None, None]
        low = np.where(there, listed["corners"], np.float32(np.inf)).min((1, 3))
        high = np.where(there, listed["corners"], np.float32(-np.inf)).max((1, 3))
        found[rows, slots, :3] = np.minimum(found[rows, slots, :3], low)
        found[rows, slots, 3:] = np.maximum(found[rows, slots, 3:], high)
    return found


def _area(boxes: np.ndarray) -> np.ndarray:
    """Half the area of each box."""
    return half_areas(boxes[..., 3:].astype(np.float64) - boxes[..., :3])


def _write(nodes: np.ndarray, touched: np.ndarray, boxes: np.ndarray, whole: np.ndarray, centre: np.ndarray) -> None:
    """Write the planes of `touched` nodes, as native/encode/boxes.h does: `boxes` of children, `whole` of nodes."""
    reach = np.maximum(centre - whole[:, :3], whole[:, 3:] - centre).max(1)
    grow = (SLAB_MARGIN * np.maximum(reach, 0.0))[:, None, None]
    planes = np.empty((len(touched), 3, 2, WIDTH), np.float32)
    planes[:, :, 0] = _below(boxes[..., :3] - centre - grow).transpose(0, 2, 1)
    planes[:, :, 1] = -_below(-(boxes[..., 3:] - centre + grow)).transpose(0, 2, 1)
    nodes.view(BOXES_NODE)[:, 0]["planes"][touched] = planes


def _below(x: np.ndarray) -> np.ndarray:
    """The largest float32 that is not above each of `x`, float64."""
    near = x.astype(np.float32)
    return np.where(near > x, np.nextafter(near, np.float32(-np.inf)), near)
