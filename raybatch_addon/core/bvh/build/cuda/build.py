"""The build of wide trees on the device that traces them: from arrays of triangles to the layout QUANTISED.

Boxes in Morton order, merged to a binary tree (`clusters.py`), which is improved (`reinsert.py`)
and collapsed to wide nodes (`collapse.py`). The host reads a few counts and never sees a triangle. Two
builds of the same input give the same bits. Everything also runs on the CPU, where tests compare it with the CPU's own
builder.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....device.devices import free_memory
from ....device.kernel import KERNEL_OPTIONS
from ....errors import OutOfMemoryError, SceneError
from ...node import TRIANGLES_MAX_QUANTISED, VECTOR_BYTES
from ..collapse import QUANTISED_COST, TOP_COST, CollapseCost
from .clusters import CLUSTER_KERNELS, ROUND_LIMIT, BinaryNodes, merge_leaves, sort_leaves, triangle_boxes
from .collapse import COLLAPSE_KERNELS, WideNodes, choose_node_children, collapse
from .order import ORDER_KERNELS, HeightOrder, find_parents, order_by_height, refit
from .reinsert import REINSERT_KERNELS, reinsert

# Levels of nodes that a traversal stack has room for
LEVELS_MAX = 64
# A tree that came out deeper is built again with so many rounds of merging and not improved: with forced pairs, whose
# number of rounds is that of the bits of the count, no binary node is then as deep as LEVELS_MAX
ROUND_LIMIT_DEEP = LEVELS_MAX - 32
# Most memory at any time of a build, its result included [bytes per triangle or box]: boxes of binary nodes 48, their
# children 8 and leaves 4, parents and what refitting needs 16, moves 42, and a little; earlier and later steps need
# less
BYTES_EACH = 125
# Vectors of triangles are counted in int32
COUNT_MAX = (2**31 - 1) // 3
VECTORS_PER_TRIANGLE = 3


@dataclass(frozen=True, kw_only=True)
class DeviceBuildStatistics:
    """Figures of a build."""

    node_steps: float  # wide nodes that a random ray through the root's box meets, by the surface area heuristic
    unit_tests: float  # triangles or entries in the leaves that it meets
    merge_rounds: int
    reinsert_rounds: int
    rebuilt: bool  # whether the first tree was too deep
    seconds: dict[str, float]  # by step: order, merge, improve, collapse, write


@dataclass(frozen=True)
class DeviceTree:
    """A wide tree of the layout QUANTISED on a device; no nodes over nothing. The host's is `node.WideTree`."""

    nodes: wp.array  # wp.vec4, shape [5 * node_count]; indices are relative to the first node
    centre: np.ndarray  # float32, shape [3]: what box coordinates are relative to
    box: np.ndarray  # float32, shape [2, 3]: lowest and highest corner of everything below, not grown
    level_first: list[int]  # first node of each level, then the node count; a node's children are in the next level
    leaf_count: int
    sah: float  # expected cost of a random ray that meets the root's box, in node steps
    statistics: DeviceBuildStatistics

    @property
    def node_count(self) -> int:
        """Nodes of the tree."""
        return self.level_first[-1]

    @property
    def depth(self) -> int:
        """Levels of nodes."""
        return len(self.level_first) - 1


@dataclass(frozen=True)
class DeviceMesh(DeviceTree):
    """The tree of one mesh with its triangles."""

    triangles: wp.array  # wp.vec4, shape [3 * triangle_count]
    triangle_count: int

    @property
    def byte_count(self) -> int:
        """Memory of nodes and triangles [bytes]."""
        return VECTOR_BYTES * (self.nodes.size + self.triangles.size)


@dataclass(frozen=True)
class DeviceTop(DeviceTree):
    """A tree over entries, in whose leaves each is alone."""

    order: wp.array  # int32: entries as leaves list them; a leaf counts from `triangle_base`


@wp.kernel(**KERNEL_OPTIONS)
def triangles_kernel(
    positions: wp.array(dtype=wp.vec3),
    triangles: wp.array(dtype=wp.vec3i),
    triangle_first: int,
    order: wp.array(dtype=int),
    out: wp.array(dtype=wp.vec4),
):
    """Triangles in the order of leaves: three corners, the number of the triangle behind the first."""
    i = wp.tid()
    face = order[i]
    triangle = triangles[triangle_first + face]
    a, b, c = positions[triangle[0]], positions[triangle[1]], positions[triangle[2]]
    out[3 * i] = wp.vec4(a[0], a[1], a[2], wp.cast(face, wp.float32))
    out[3 * i + 1] = wp.vec4(b[0], b[1], b[2], 0.0)
    out[3 * i + 2] = wp.vec4(c[0], c[1], c[2], 0.0)


DEVICE_BUILD_KERNELS = (*CLUSTER_KERNELS, *ORDER_KERNELS, *REINSERT_KERNELS, *COLLAPSE_KERNELS, triangles_kernel)


def build_mesh(
    positions: wp.array, triangles: wp.array, first: int, count: int, cost: CollapseCost = QUANTISED_COST
) -> DeviceMesh:
    """The tree over triangles [first, first + count), which it calls 0 .. count - 1.

    Args:
        positions: [m], wp.vec3, finite.
        triangles: wp.vec3i, on the same device.
        cost: weights of a node and of a triangle.

    Raises `OutOfMemoryError` where the build does not fit, `SceneError` for more than `COUNT_MAX` and for coordinates
    that are not finite.
    """
    device = positions.device
    _check_memory(device, count, "triangles")
    clock = _Clock(device)
    if count == 0:
        none = wp.empty(0, dtype=wp.vec4, device=device)
        return DeviceMesh(none, *_nothing(), none, 0)
    wide, common = _build(
        lambda: triangle_boxes(positions, triangles, first, count), cost, TRIANGLES_MAX_QUANTISED, clock
    )
    blocks = wp.empty(VECTORS_PER_TRIANGLE * count, dtype=wp.vec4, device=device)
    wp.launch(triangles_kernel, count, [positions, triangles, first, wide.order, blocks], device=device)
    clock.end("write")
    return DeviceMesh(wide.nodes, *common, blocks, count)


def build_top(low: wp.array, high: wp.array, cost: CollapseCost = TOP_COST) -> DeviceTop:
    """The tree over entries whose boxes have the corners `low` and `high` [m], wp.vec3, finite; raises as
    `build_mesh`.
    """
    device, count = low.device, low.size
    _check_memory(device, count, "entries")
    if count == 0:
        nodes, order = wp.empty(0, dtype=wp.vec4, device=device), wp.empty(0, dtype=int, device=device)
        return DeviceTop(nodes, *_nothing(), order)
    wide, common = _build(lambda: (low, high), cost, 1, _Clock(device))
    return DeviceTop(wide.nodes, *common, wide.order)


class _Clock:
    """Seconds by step, the device's work included."""

    def __init__(self, device: wp.Device):
        self._device = device
        self.seconds: dict[str, float] = {}
        wp.synchronize_device(device)
        self._last = time.perf_counter()

    def end(self, step: str) -> None:
        wp.synchronize_device(self._device)
        now = time.perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - self._last
        self._last = now


def _build(
    boxes: Callable[[], tuple[wp.array, wp.array]], cost: CollapseCost, leaf_max: int, clock: _Clock
) -> tuple[WideNodes, tuple]:
    """Wide nodes over `boxes`, and the fields of `DeviceTree` behind `nodes`."""
    wide, common = _attempt(boxes, cost, leaf_max, clock, ROUND_LIMIT, improve=True)
    if wide is None:
        wide, common = _attempt(boxes, cost, leaf_max, clock, ROUND_LIMIT_DEEP, improve=False)
    assert wide is not None
    return wide, common


def _attempt(
    boxes: Callable[[], tuple[wp.array, wp.array]],
    cost: CollapseCost,
    leaf_max: int,
    clock: _Clock,
    round_limit: int,
    improve: bool,
) -> tuple[WideNodes | None, tuple]:
    """Build as `_build` does; no nodes where the tree is too deep."""
    low, high = boxes()
    tree, clusters = sort_leaves(low, high)
    del low, high
    clock.end("order")
    merge_leaves(tree, clusters, round_limit)
    del clusters
    clock.end("merge")
    order, reinsert_rounds = None, 0
    if tree.nodes.leaf_count > 1:
        order, reinsert_rounds = _improved(tree.nodes, improve)
        if order is None:
            return None, ()
    clock.end("improve")
    centre = 0.5 * tree.box[0] + 0.5 * tree.box[1]
    choices = choose_node_children(tree.nodes, order, cost, leaf_max)
    del order
    wide = collapse(tree.nodes, choices, centre)
    clock.end("collapse")
    if len(wide.level_first) - 1 > LEVELS_MAX:
        return None, ()
    statistics = DeviceBuildStatistics(
        node_steps=wide.node_steps,
        unit_tests=wide.unit_tests,
        merge_rounds=tree.round_count,
        reinsert_rounds=reinsert_rounds,
        rebuilt=not improve,
        seconds=clock.seconds,
    )
    sah = cost.node * wide.node_steps + cost.unit * wide.unit_tests
    return wide, (centre, tree.box, wide.level_first, wide.leaf_count, sah, statistics)


def _improved(nodes: BinaryNodes, improve: bool) -> tuple[HeightOrder | None, int]:
    """The inner nodes bottom-up, after reinsertion where asked for, and its rounds; None for a tree too high."""
    links = find_parents(nodes)
    rounds = reinsert(nodes, links) if improve else 0
    if rounds == 0:
        refit(nodes, links)
    return order_by_height(nodes, links), rounds


def _nothing() -> tuple:
    """The fields of `DeviceTree` behind `nodes` of a tree over nothing."""
    zero = np.zeros(3, np.float32)
    return (
        zero,
        np.stack([zero, zero]),
        [0],
        0,
        0.0,
        DeviceBuildStatistics(
            node_steps=0.0, unit_tests=0.0, merge_rounds=0, reinsert_rounds=0, rebuilt=False, seconds={}
        ),
    )


def _check_memory(device: wp.Device, count: int, what: str) -> None:
    if count > COUNT_MAX:
        raise SceneError(f"a tree on a device holds {COUNT_MAX:,} {what}, not {count:,}; split the mesh")
    needed, free = count * BYTES_EACH, free_memory(device)
    if needed > free:
        raise OutOfMemoryError(
            f"the tree over {count:,} {what} needs {needed / 1e9:.2f} GB while it is built, and {device.name} has "
            f"{free / 1e9:.2f} GB "
            "free; use fewer triangles, or a device with more memory"
        )
