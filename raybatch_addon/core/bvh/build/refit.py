"""A wide tree for new vertex positions with the same triangles: same nodes, new boxes.

Blocks of triangles take the new vertices, boxes are joined from the deepest nodes up, then every node is written anew.
Parts of triangles that were split for the old positions mean nothing now, so boxes hold whole triangles. A refitted
tree is valid but gets worse the more triangles move apart: compare its `sah` with that of the tree that was built, and
build again when it has grown too much (a factor of 1.5 to 2 is usual; Wald, Boulos and Shirley 2007, "Ray tracing
deformable scenes using dynamic bounding volume hierarchies").

QUANTISED is refitted by kernels on either device, level by level; BOXES on the CPU, where its order (a node before what
is below it) makes levels needless.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...native.build import native_source
from ...native.structs import to_numpy
from ..node import Layout, decode_children
from .collapse import BOXES_COST, QUANTISED_COST, CollapseCost
from .encode import ENCODE_BOXES, ENCODE_QUANTISED, place_groups_kernel, place_triangles_kernel


@dataclass(frozen=True)
class NodeLevels:
    """The nodes of a tree by their distance from the root."""

    nodes: wp.array  # int32, shape [n]: the root, its children, and so on
    first: list[int]  # index in `nodes` of the first of each level, then their count; length levels + 1


@dataclass(frozen=True)
class RefitResult:
    """The figures of a refitted tree; its blocks are written in place."""

    centre: np.ndarray  # float32, shape [3]
    box: np.ndarray  # float32, shape [2, 3], absolute
    sah: float  # as `WideTree.sah`
    # of BOXES, where the whole was refitted: boxes of whole triangles below each node, float32, shape [node_count, 6],
    # absolute; and each node's part of `sah`, float64, shape [node_count]
    boxes: np.ndarray | None = None
    costs: np.ndarray | None = None


@wp.struct
class RefitWork:
    """A tree that is refitted in place."""

    nodes: wp.array(dtype=wp.vec4)
    blocks: wp.array(dtype=wp.vec4)  # triangles, with their new vertices
    node_count: int
    step_count: int  # of positions: boxes are around the triangles at all of them
    unit_count: int  # blocks of one step, which lie one step behind another
    boxes: wp.array(
        dtype=float
    )  # box of whole triangles below each node, absolute, shape [6 n]: low corner, high corner
    cost: wp.array(dtype=wp.float64)  # part of the `sah` of each node and its leaves
    node_cost: float
    unit_cost: float


_QUANTISED = {**ENCODE_QUANTISED, "UNIT_WORDS": Layout.QUANTISED.triangle_words}


@wp.func_native(native_source("refit/start.h", "refit/children_of_boxes.h", "refit/join.h", **ENCODE_BOXES))
def join_boxes(work: RefitWork, i: int): ...


@wp.func_native(native_source("refit/start.h", "refit/children_of_quantised.h", "refit/join.h", **_QUANTISED))
def join_quantised(work: RefitWork, i: int): ...


@wp.func_native(
    native_source(
        "encode/rounding.h",
        "refit/start.h",
        "refit/children_of_boxes.h",
        "refit/measure.h",
        "encode/boxes.h",
        **ENCODE_BOXES,
    )
)
def write_boxes(work: RefitWork, i: int): ...


@wp.func_native(
    native_source(
        "encode/rounding.h",
        "refit/start.h",
        "refit/children_of_quantised.h",
        "refit/measure.h",
        "encode/quantised.h",
        **_QUANTISED,
    )
)
def write_quantised(work: RefitWork, i: int): ...


@wp.kernel(**KERNEL_OPTIONS)
def join_boxes_kernel(work: RefitWork):
    """Boxes of all nodes of BOXES, from the last to the root (one thread)."""
    for i in range(work.node_count):
        join_boxes(work, work.node_count - 1 - i)


@wp.kernel(**KERNEL_OPTIONS)
def write_boxes_kernel(work: RefitWork):
    """New child boxes in each node of BOXES."""
    write_boxes(work, wp.tid())


@wp.kernel(**KERNEL_OPTIONS)
def join_quantised_kernel(work: RefitWork, level_nodes: wp.array(dtype=int), first: int):
    """Boxes of the nodes of one level of QUANTISED, whose children are done."""
    join_quantised(work, level_nodes[first + wp.tid()])


@wp.kernel(**KERNEL_OPTIONS)
def write_quantised_kernel(work: RefitWork):
    """New child boxes, quantised, in each node of QUANTISED."""
    write_quantised(work, wp.tid())


def node_levels(nodes: np.ndarray, device: wp.Device | str) -> NodeLevels:
    """Levels of a tree of QUANTISED, whose nodes on the host are given (shape [n, 20]); kept as long as the
    topology.
    """
    inner = decode_children(Layout.QUANTISED, nodes).inner
    level = np.zeros(1, np.int64)
    levels = []
    while len(level):
        levels.append(level)
        below = inner[level]
        level = below[below >= 0]
    first = np.cumsum([0, *(len(level) for level in levels)]).tolist()
    return NodeLevels(wp.array(np.concatenate(levels).astype(np.int32), dtype=int, device=device), first)


def refit_quantised(
    nodes: wp.array,
    blocks: wp.array,
    levels: NodeLevels,
    positions: wp.array | Sequence[wp.array],
    triangles: wp.array,
    cost: CollapseCost = QUANTISED_COST,
) -> RefitResult:
    """Refit a tree of QUANTISED in place, on the device that its arrays are on.

    Args:
        nodes: the tree's nodes, vec4, shape [5 n].
        blocks: its triangles, vec4, shape [3 t].
        levels: of its nodes, on the same device.
        positions: new vertices, vec3; or those of several steps, between which they move: then `blocks` holds as many
            copies.
        triangles: the mesh's triangles, vec3i, indices into `positions`.
        cost: weights for `sah`.
    """
    device = nodes.device
    steps = _steps(positions)
    work = _start(nodes, blocks, len(levels.nodes), len(steps), Layout.QUANTISED, cost)
    for at, placed in zip(steps, _copies(blocks, len(steps))):
        wp.launch(place_triangles_kernel, dim=work.unit_count, inputs=[placed, at, triangles], device=device)
    for first, end in zip(levels.first[-2::-1], levels.first[:0:-1]):
        wp.launch(join_quantised_kernel, dim=end - first, inputs=[work, levels.nodes, first], device=device)
    wp.launch(write_quantised_kernel, dim=work.node_count, inputs=[work], device=device)
    return _result(work)


def refit_boxes(
    nodes: wp.array,
    blocks: wp.array,
    positions: wp.array | Sequence[wp.array],
    triangles: wp.array,
    cost: CollapseCost = BOXES_COST,
) -> RefitResult:
    """Refit a tree of BOXES in place, on the CPU: nodes vec4, shape [16 n], groups vec4, shape [20 g]; the rest as
    `refit_quantised`.
    """
    steps = _steps(positions)
    work = _start(nodes, blocks, nodes.size // 16, len(steps), Layout.BOXES, cost)
    for at, placed in zip(steps, _copies(blocks, len(steps))):
        wp.launch(place_groups_kernel, dim=work.unit_count, inputs=[placed, at, triangles], device="cpu")
    wp.launch(join_boxes_kernel, dim=1, inputs=[work], device="cpu")
    wp.launch(write_boxes_kernel, dim=work.node_count, inputs=[work], device="cpu")
    return replace(_result(work), boxes=to_numpy(work.boxes).reshape(-1, 6).copy(), costs=to_numpy(work.cost).copy())


def _steps(positions: wp.array | Sequence[wp.array]) -> Sequence[wp.array]:
    return [positions] if isinstance(positions, wp.array) else positions


def _copies(blocks: wp.array, count: int) -> list[wp.array]:
    """The blocks of each step."""
    size = blocks.size // count
    return [blocks[i * size : (i + 1) * size] for i in range(count)]


def _start(
    nodes: wp.array, blocks: wp.array, node_count: int, step_count: int, layout: Layout, cost: CollapseCost
) -> RefitWork:
    work = RefitWork()
    work.nodes, work.blocks, work.node_count = nodes, blocks, node_count
    work.step_count, work.unit_count = step_count, blocks.size * 4 // layout.triangle_words // step_count
    work.boxes = wp.empty(6 * node_count, dtype=float, device=nodes.device)
    work.cost = wp.empty(node_count, dtype=wp.float64, device=nodes.device)
    work.node_cost, work.unit_cost = cost.node, cost.unit
    return work


def _result(work: RefitWork) -> RefitResult:
    box = to_numpy(work.boxes[:6]).reshape(2, 3).copy()
    centre = ((box[0].astype(np.float64) + box[1]) / 2).astype(np.float32)
    return RefitResult(centre, box, float(wp.utils.array_sum(work.cost)))
