"""Walks through trees over time that were not built: how many nodes rays would visit, followed level by level in NumPy.

Every ray knows how far its closest hit is from the start, so that the order of visits does not matter: counts are a
little below those of a traversal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raybatch_addon.core.bvh.build.binary import DEPTH_MAX
from raybatch_addon.core.bvh.build.entries import boxes_over_time
from raybatch_addon.core.bvh.build.scene_tree import BuiltTree
from raybatch_addon.core.bvh.node import BOXES_GROUP, WIDTH, Layout, decode_children, half_areas
from raybatch_addon.core.scene.motion import KEY_FLOATS, knots
from studies.motion.moving import AimedRays

_PAIRS = 1 << 18  # rays and nodes that are looked at together
_TIMES_MOST = 8  # ranges of time that one thing may be split into


@dataclass
class Nodes:
    """Wide nodes whose boxes move along lines between evenly spaced times; of one time they stand still."""

    box: np.ndarray  # float64, shape [times, n, 8, 2, 3]; of an empty slot nothing is met
    inner: np.ndarray  # node, or -1, shape [n, 8]
    leaf: np.ndarray  # number of what a leaf lists, or -1, shape [n, 8]
    when: np.ndarray | None = None  # first and last time of a child, shape [n, 8, 2]; None: all of the time


def linear_nodes(words: np.ndarray, leaf_boxes: np.ndarray) -> Nodes:
    """The nodes `words` of BOXES, whose leaf children, in the order of nodes and slots, have the boxes `leaf_boxes`,
    shape [times, leaves, 2, 3].
    """
    children = decode_children(Layout.BOXES, words)
    is_leaf = children.count > 0
    number = np.where(is_leaf, np.cumsum(is_leaf).reshape(is_leaf.shape) - 1, -1)
    box = np.empty((len(leaf_boxes), len(words), WIDTH, 2, 3))
    box[..., 0, :], box[..., 1, :] = np.inf, -np.inf
    box[:, is_leaf] = leaf_boxes
    for i in range(len(words) - 1, -1, -1):  # a node comes before what is below it
        for slot in np.flatnonzero(children.inner[i] >= 0):
            below = box[:, children.inner[i, slot]]
            box[:, i, slot, 0], box[:, i, slot, 1] = below[:, :, 0].min(1), below[:, :, 1].max(1)
    return Nodes(box, children.inner, number)


def walk(nodes: Nodes, rays: AimedRays, t: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Node visits of `rays` that end at the distances `t`, and the leaves that each meets: its number, the leaf's."""
    inverse = 1 / np.where(rays.direction == 0, 1e-30, rays.direction.astype(np.float64))
    origin, time = rays.origin.astype(np.float64), rays.time.astype(np.float64)
    waiting = [(np.arange(len(time)), np.zeros(len(time), np.int64))]
    visits, met_ray, met_leaf = 0, [], []
    while waiting:
        ray, node = waiting.pop()
        if len(ray) > _PAIRS:
            waiting += [(ray[_PAIRS:], node[_PAIRS:])]
            ray, node = ray[:_PAIRS], node[:_PAIRS]
        visits += len(ray)
        box = _boxes_at(nodes.box, node, time[ray])
        near, far = ((box[:, :, k] - origin[ray, None]) * inverse[ray, None] for k in (0, 1))
        enter = np.minimum(near, far).max(2)
        leave = np.minimum(np.maximum(near, far).min(2), t[ray, None])
        hit = (np.maximum(enter, 0) <= leave * (1 + 1e-6)) & np.isfinite(box[:, :, 0, 0])
        if nodes.when is not None:
            when, at = nodes.when[node], time[ray, None]
            hit &= (at >= when[:, :, 0]) & ((at < when[:, :, 1]) | (when[:, :, 1] == 1))
        pair, slot = np.nonzero(hit & (nodes.leaf[node] >= 0))
        met_ray.append(ray[pair])
        met_leaf.append(nodes.leaf[node[pair], slot])
        pair, slot = np.nonzero(hit & (nodes.inner[node] >= 0))
        if len(pair):
            waiting.append((ray[pair], nodes.inner[node[pair], slot]))
    return visits, np.concatenate(met_ray), np.concatenate(met_leaf)


def _boxes_at(box: np.ndarray, node: np.ndarray, time: np.ndarray) -> np.ndarray:
    if len(box) == 1:
        return box[0, node]
    at = time * (len(box) - 1)
    step = np.minimum(at.astype(int), len(box) - 2)
    share = (at - step)[:, None, None, None]
    with np.errstate(invalid="ignore"):  # empty slots
        return (1 - share) * box[step, node] + share * box[step + 1, node]


# --- the top level over things that move


def entry_boxes(built: BuiltTree, first: float | None = None, last: float = 1.0) -> np.ndarray:
    """Boxes of the entries of a tree with one range, float64, shape [times, n, 2, 3]: at the times between which they
    move along lines, or from one time to another.
    """
    tree, meshes = built.tree, built.meshes
    box = np.array([mesh.box for mesh in meshes], np.float64)[built.entry_mesh]
    keys = tree.motion_keys.numpy().reshape(-1, tree.motion_steps, KEY_FLOATS)
    row, still = tree.entry_motion.numpy(), tree.entry_from_world.numpy().astype(np.float64)
    times = [(time, time) for time in knots(keys)] if first is None else [(first, last)]
    found = np.empty((len(times), len(row), 2, 3))
    linear = np.linalg.inv(still[:, :, :3])
    middle = np.einsum("nij,nj->ni", linear, box.mean(1) - still[:, :, 3])
    reach = np.einsum("nij,nj->ni", np.abs(linear), (box[:, 1] - box[:, 0]) / 2)
    found[:, :, 0], found[:, :, 1] = middle - reach, middle + reach
    moving = np.flatnonzero(row >= 0)
    for i, (begin, end) in enumerate(times):
        found[i, moving] = boxes_over_time(keys[row[moving]], box[moving], begin, end)
    return found


def split_in_time(built: BuiltTree) -> Nodes:
    """One tree whose binary nodes part things or their time, whichever costs less (after Woop, Áfra and Benthin 2017),
    collapsed to eight children.
    """
    boxes: dict[tuple[float, float], np.ndarray] = {}

    def boxes_in(first: float, last: float) -> np.ndarray:
        if (first, last) not in boxes:
            boxes[first, last] = entry_boxes(built, first, last)[0]
        return boxes[first, last]

    def area(who: np.ndarray, first: float, last: float) -> float:
        return float(half_areas(np.ptp(_around(boxes_in(first, last)[who]), axis=0)))

    def may_part(who: np.ndarray, first: float, last: float) -> bool:
        """One thing alone is parted where boxes of half of its time are a good deal smaller."""
        if len(who) > 1:
            return True
        middle = (first + last) / 2
        if last - first <= 1 / _TIMES_MOST:
            return False
        return area(who, first, middle) + area(who, middle, last) < 1.6 * area(who, first, last)

    def part(who: np.ndarray, first: float, last: float) -> tuple[list, float]:
        """The two parts of the things `who` at the times from `first` to `last` that cost least, and what they cost."""
        own = boxes_in(first, last)[who]
        best, cost = [], np.inf
        for axis in range(3):
            order = np.argsort(own[:, :, axis].mean(1), kind="stable")
            low, high = own[order, 0], own[order, 1]
            up = half_areas(np.maximum.accumulate(high) - np.minimum.accumulate(low))
            down = half_areas(np.maximum.accumulate(high[::-1]) - np.minimum.accumulate(low[::-1]))[::-1]
            count = np.arange(1, len(who))
            costs = (up[:-1] * count + down[1:] * count[::-1]) * (last - first)
            if len(costs) and costs.min() < cost:
                cost, at = float(costs.min()), int(costs.argmin()) + 1
                best = [(who[order[:at]], first, last), (who[order[at:]], first, last)]
        if last - first > 1 / _TIMES_MOST:
            middle = (first + last) / 2
            halves = [(first, middle), (middle, last)]
            split = sum(area(who, *half) for half in halves) * len(who) * (last - first) / 2
            if split < cost:
                best = [(who, *half) for half in halves]
        return best, cost

    rows: list[tuple[list, list, list, list]] = []
    todo: list[tuple[np.ndarray, float, float, tuple[int, int] | None]] = [(np.arange(_count(built)), 0.0, 1.0, None)]
    while todo:
        who, first, last, above = todo.pop()
        if above is not None:
            rows[above[0]][1][above[1]] = len(rows)
        children = [(who, first, last)]
        for _ in range(DEPTH_MAX):
            open_ones = [i for i, each in enumerate(children) if may_part(*each)]
            if len(children) == WIDTH or not open_ones:
                break
            widest = max(open_ones, key=lambda i: area(*children[i]))
            children += part(*children.pop(widest))[0]
        box, inner, leaf, when = [], [-1] * WIDTH, [-1] * WIDTH, []
        for slot, each in enumerate(children):
            box.append(_around(boxes_in(*each[1:])[each[0]]))
            when.append(each[1:])
            if not may_part(*each):
                leaf[slot] = int(each[0][0])
            else:
                todo.append((*each, (len(rows), slot)))
        rows.append((box, inner, leaf, when))
    boxes_of, times_of = np.full((1, len(rows), WIDTH, 2, 3), np.nan), np.zeros((len(rows), WIDTH, 2))
    for i, (box, _, _, when) in enumerate(rows):
        boxes_of[0, i, : len(box)], times_of[i, : len(when)] = box, when
    return Nodes(boxes_of, np.array([row[1] for row in rows]), np.array([row[2] for row in rows]), times_of)


def _count(built: BuiltTree) -> int:
    assert built.entry_mesh is not None, "it is whole"
    return len(built.entry_mesh)


def _around(boxes: np.ndarray) -> np.ndarray:
    return np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)])


# --- a mesh


def mesh_nodes(built: BuiltTree, mesh: int) -> tuple[Nodes, np.ndarray]:
    """The nodes of a mesh tree with a box at each of its steps, and how many triangles each of its leaves holds."""
    made = built.meshes[mesh]
    words = made.nodes.numpy().reshape(-1, Layout.BOXES.node_words)
    blocks = np.ascontiguousarray(made.triangles.numpy().reshape(-1, Layout.BOXES.triangle_words))
    groups = blocks.view(BOXES_GROUP)[:, 0]
    unit_count = made.step_units or len(groups)
    groups = groups.reshape(-1, unit_count)
    there = groups["face"][0] >= 0
    corners = groups["corners"].astype(np.float64)  # [steps, groups, corner, axis, lane]
    low = np.where(there[None, :, None], corners.min(2), np.inf).min(3)
    high = np.where(there[None, :, None], corners.max(2), -np.inf).max(3)
    children = decode_children(Layout.BOXES, words)
    is_leaf = children.count > 0
    first, count = children.first[is_leaf], children.count[is_leaf]
    ends = np.stack([first, first + count], 1).ravel()
    padded = [np.concatenate([each, each[:, -1:]], 1) for each in (low, high)]
    boxes = np.stack(
        [np.minimum.reduceat(padded[0], ends, 1)[:, ::2], np.maximum.reduceat(padded[1], ends, 1)[:, ::2]], 2
    )
    held = np.add.reduceat(np.append(there.sum(1), 0), ends)[::2]
    return linear_nodes(words, boxes), held
