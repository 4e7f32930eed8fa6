"""A wide tree made of a binary one, in either layout, on the CPU.

Which binary nodes become children of a wide node is found by dynamic programming over the binary tree (Ylitie, Karras
and Laine 2017, section 3.1): for each binary node, the least cost of covering it with at most 1 to 7 parts, each a wide
node or a leaf. Subtrees with few references may be merged into one leaf. A part costs its surface area over that of the
root, times a weight for a node or for each unit of a leaf (a group of eight triangles, one triangle, one entry).

Three passes: `choose` from the last binary node to the first (children come after their parent), `arrange` from the
root down (numbers nodes and writes down what leaves list: the plan), `fill` node by node. None of them recurses:
`arrange` keeps a stack of wide nodes. Their C++ is in `native/collapse`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...native.build import native_source
from ...native.structs import to_numpy
from ..node import (
    EMPTY_CHILD,
    GROUPS_MAX,
    TRIANGLES_MAX_BOXES,
    TRIANGLES_MAX_QUANTISED,
    WIDTH,
    Layout,
    WideMesh,
    WideTop,
    aligned_empty,
    triangle_faces,
)
from .binary import DEPTH_MAX, BinaryTree
from .encode import ENCODE_BOXES, ENCODE_QUANTISED, as_vectors, place_groups_kernel, place_triangles_kernel


class CollapseOutcome(IntEnum):
    """The outcome of a pass: why it ended without a tree, if it did."""

    NO_ERROR = 0
    LEAF_TOO_LARGE = 1
    CHILD_BEFORE_PARENT = 2
    TOO_DEEP = 3
    TOO_MANY_LISTED = 4


class PlanFigure(IntEnum):
    """Indices of the error and of the figures of a plan in `CollapseWork.found`."""

    ERROR = 0
    NODE_COUNT = 1
    LISTED = 2  # words of `order`
    LEVELS = 3
    LEAF_COUNT = 4
    REFERENCE_COUNT = 5  # in leaves


_MESSAGES = {
    CollapseOutcome.LEAF_TOO_LARGE: "a leaf of the binary tree lists more than a leaf of this layout can",
    CollapseOutcome.CHILD_BEFORE_PARENT: "children of a binary node must come after it",
    CollapseOutcome.TOO_DEEP: "the binary tree is too deep",
    CollapseOutcome.TOO_MANY_LISTED: "leaves list more than indices of 32 bits can name",
}
_PLAN = {"DEPTH_MAX": DEPTH_MAX, **{each.name: each.value for each in (*CollapseOutcome, *PlanFigure)}}
_NO_ERROR = wp.constant(int(CollapseOutcome.NO_ERROR))
_ERROR, _NODE_COUNT = wp.constant(int(PlanFigure.ERROR)), wp.constant(int(PlanFigure.NODE_COUNT))


@dataclass(frozen=True)
class CollapseCost:
    """Weights of the surface area heuristic."""

    node: float = 1.0  # one step through a node
    unit: float = 1.0  # one unit of a leaf: a group of triangles, a triangle, or an entry
    # one unit for every full unit that the references make: what memory costs, whether it is met or not
    size: float = 0.0


# Groups are padded to eight triangles: the cost of size fills them by 7 instead of 5.6 where it hardly matters for the
# steps (measured: a fifth less memory, as fast or 2 % faster). Triangles of QUANTISED take the same memory however they
# are shared out.
BOXES_COST = CollapseCost(1.0, 1.0, 1.0)
QUANTISED_COST = CollapseCost(1.0, 0.35)
TOP_COST = CollapseCost(1.0, 4.0)  # an entry is a tree of its own


@wp.struct
class CollapseWork:
    """Arrays and numbers that the passes share."""

    nodes: wp.array2d(dtype=float)  # binary nodes, shape [n, 8]
    node_count: int
    references: wp.array(dtype=int)
    positions: wp.array(dtype=wp.vec3)
    triangles: wp.array(dtype=wp.vec3i)  # none over entries
    centre: wp.vec3
    clipped: bool  # references were split: boxes may be smaller than their triangles, and leaves may list one twice
    reach: wp.array(dtype=float)  # if clipped: largest |vertex - centre| below each binary node
    node_cost: float
    unit_cost: float
    size_cost: float  # added to the chance that a node or a unit is met, for the memory that it takes
    unit: int  # references of a unit of a leaf
    leaf_max: int  # most references of a merged leaf
    cost: wp.array2d(dtype=float)  # of at most 1 to 7 parts, shape [n, 8]
    choice: wp.array2d(
        dtype=wp.uint8
    )  # shape [n, 8]; [0]: whether one part is a leaf; [j]: of j + 1 parts, those of the first child;
    # 0: j parts are as good
    below: wp.array(dtype=int)  # references below each binary node
    plan: wp.array2d(
        dtype=int
    )  # shape [wide nodes or more, 16]: binary node of each slot or -1, then BOXES: the word of each child; QUANTISED:
    # first child, first triangle, meta (2 words), mask
    order: wp.array2d(dtype=int)  # what leaves list, shape [units or more, references of a unit]; -1 fills units up
    found: wp.array(dtype=int)  # by `PlanFigure`
    sah: wp.array(dtype=wp.float64)


@wp.func_native(
    native_source(
        "encode/rounding.h", "collapse/binary.h", "collapse/choose.h", WIDTH=WIDTH, GROUPS_MAX=GROUPS_MAX, **_PLAN
    )
)
def choose(work: CollapseWork) -> int: ...


@wp.func_native(
    native_source(
        "collapse/binary.h",
        "collapse/arrange.h",
        "collapse/arrange_boxes.h",
        "collapse/arranged.h",
        EMPTY_CHILD=EMPTY_CHILD,
        **_PLAN,
    )
)
def arrange_boxes(work: CollapseWork) -> int: ...


@wp.func_native(
    native_source(
        "collapse/binary.h", "collapse/arrange.h", "collapse/arrange_quantised.h", "collapse/arranged.h", **_PLAN
    )
)
def arrange_quantised(work: CollapseWork) -> int: ...


@wp.func_native(
    native_source(
        "encode/rounding.h",
        "collapse/binary.h",
        "collapse/child_boxes.h",
        "collapse/fill_boxes.h",
        "encode/boxes.h",
        **ENCODE_BOXES,
    )
)
def fill_boxes(work: CollapseWork, nodes: wp.array(dtype=wp.vec4), i: int): ...


@wp.func_native(
    native_source(
        "encode/rounding.h",
        "collapse/binary.h",
        "collapse/child_boxes.h",
        "collapse/fill_quantised.h",
        "encode/quantised.h",
        **ENCODE_QUANTISED,
    )
)
def fill_quantised(work: CollapseWork, nodes: wp.array(dtype=wp.vec4), i: int): ...


@wp.kernel(**KERNEL_OPTIONS)
def collapse_boxes_kernel(work: CollapseWork):
    """The plan of a tree in the layout BOXES (one thread)."""
    error = choose(work)
    if error == _NO_ERROR:
        error = arrange_boxes(work)
    work.found[_ERROR] = error


@wp.kernel(**KERNEL_OPTIONS)
def collapse_quantised_kernel(work: CollapseWork):
    """The plan of a tree in the layout QUANTISED (one thread)."""
    error = choose(work)
    if error == _NO_ERROR:
        error = arrange_quantised(work)
    work.found[_ERROR] = error


@wp.kernel(**KERNEL_OPTIONS)
def fill_boxes_kernel(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)):
    """Nodes of BOXES as planned, shape [16 n] (one thread)."""
    for i in range(work.found[_NODE_COUNT]):
        fill_boxes(work, nodes, i)


@wp.kernel(**KERNEL_OPTIONS)
def fill_quantised_kernel(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)):
    """Nodes of QUANTISED as planned, shape [5 n] (one thread)."""
    for i in range(work.found[_NODE_COUNT]):
        fill_quantised(work, nodes, i)


def collapse_mesh(
    binary: BinaryTree, positions: np.ndarray, triangles: np.ndarray, layout: Layout, cost: CollapseCost | None = None
) -> WideMesh:
    """The wide tree of a mesh.

    Args:
        binary: tree over the triangles, of at least one.
        positions: float32, shape [v, 3].
        triangles: int32, shape [m, 3].
        layout: of nodes and triangles.
        cost: weights of a node and of a group of triangles (BOXES) or a triangle (QUANTISED).
    """
    boxes = layout is Layout.BOXES
    cost = cost or (BOXES_COST if boxes else QUANTISED_COST)
    work = _start(binary, layout, WIDTH if boxes else 1)
    work.positions = wp.array(positions, dtype=wp.vec3, device="cpu", copy=False)
    work.triangles = wp.array(triangles, dtype=wp.vec3i, device="cpu", copy=False)
    work.clipped = binary.statistics.duplicate_count > 0
    if work.clipped:
        work.reach = _scratch((len(binary.nodes),), float)
    tree, order = _collapse(work, binary, layout, cost)
    blocks = aligned_empty((len(order) // work.unit, layout.triangle_words), np.float32)
    faces = triangle_faces(layout, blocks)
    faces[:] = order.reshape(faces.shape)
    kernel = place_groups_kernel if boxes else place_triangles_kernel
    wp.launch(kernel, dim=len(blocks), inputs=[as_vectors(blocks), work.positions, work.triangles], device="cpu")
    return WideMesh(**tree, triangles=blocks, triangle_count=len(triangles))


def collapse_entries(binary: BinaryTree, layout: Layout, cost: CollapseCost = TOP_COST) -> WideTop:
    """The wide tree over entries, from a binary tree over their boxes."""
    work = _start(binary, layout, 1)
    tree, order = _collapse(work, binary, layout, cost)
    return WideTop(**tree, order=order.copy())


def _start(binary: BinaryTree, layout: Layout, unit: int) -> CollapseWork:
    if len(binary.nodes) == 0:
        raise ValueError("an empty tree cannot be collapsed")
    node_count, leaf_count = len(binary.nodes), (len(binary.nodes) + 1) // 2
    work = CollapseWork()
    work.nodes = wp.array(binary.nodes, dtype=float, device="cpu", copy=False)
    work.references = wp.array(binary.references, dtype=int, device="cpu", copy=False)
    work.node_count = node_count
    work.unit = unit
    work.leaf_max = TRIANGLES_MAX_BOXES if layout is Layout.BOXES else TRIANGLES_MAX_QUANTISED
    work.cost = _scratch((node_count, 8), float)
    work.choice = _scratch((node_count, 8), wp.uint8)
    work.below = _scratch((node_count,), int)
    # the system gives memory when it is first written: these may be too large
    work.plan = _scratch((max(leaf_count - 1, 1), 16), int)
    work.order = _scratch((len(binary.references) // unit + leaf_count, unit), int)
    work.centre = wp.vec3(*_centre(binary.nodes[0]).tolist())
    work.found = wp.zeros(len(PlanFigure), dtype=int, device="cpu")
    work.sah = wp.zeros(1, dtype=wp.float64, device="cpu")
    return work


def _collapse(
    work: CollapseWork, binary: BinaryTree, layout: Layout, cost: CollapseCost
) -> tuple[dict[str, Any], np.ndarray]:
    """Run the passes; returns the fields of a `WideTree` and what its leaves list."""
    boxes = layout is Layout.BOXES
    work.node_cost, work.unit_cost = cost.node, cost.unit
    # never 0: among boxes that are equal or empty, fewer nodes must be cheaper
    work.size_cost = cost.size * work.unit / len(binary.references) + 1e-9
    wp.launch(collapse_boxes_kernel if boxes else collapse_quantised_kernel, dim=1, inputs=[work], device="cpu")
    error, node_count, listed, depth, leaf_count, reference_count = to_numpy(work.found).tolist()
    if error:
        raise ValueError(_MESSAGES[CollapseOutcome(error)])
    nodes = aligned_empty((node_count, layout.node_words), layout.node_type)
    wp.launch(
        fill_boxes_kernel if boxes else fill_quantised_kernel, dim=1, inputs=[work, as_vectors(nodes)], device="cpu"
    )
    root = binary.nodes[0]
    tree = {
        "layout": layout,
        "nodes": nodes,
        "centre": _centre(root),
        "box": np.stack([root[:3], root[4:7]]),
        "depth": depth,
        "leaf_count": leaf_count,
        "reference_count": reference_count,
        "sah": float(to_numpy(work.sah)[0]),
    }
    return tree, to_numpy(work.order).reshape(-1)[:listed]


def _centre(root: np.ndarray) -> np.ndarray:
    return ((root[:3].astype(np.float64) + root[4:7]) / 2).astype(np.float32)


def _scratch(shape: tuple[int, ...], dtype: type) -> wp.array:
    return wp.empty(shape, dtype=dtype, device="cpu")
