"""From a binary tree to a wide one, in either layout, on the CPU.

Which binary nodes become children of a wide node is found by dynamic programming over the binary tree (Ylitie, Karras and Laine
2017, section 3.1): for each binary node, the least cost of covering it with at most 1 to 7 parts, each a wide node or a leaf. Subtrees
with few references may be merged into one leaf. A part costs its surface area over that of the root, times a weight for a node
or for each unit of a leaf (a group of eight triangles, one triangle, one entry).

Three passes: `choose` from the last binary node to the first (children come after their parent), `arrange` from the root down
(numbers nodes and writes down what leaves list: the plan), `fill` node by node. `collapse_native.py` holds their text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..kernel import KERNEL_OPTIONS
from .binary import BinaryTree
from .collapse_native import (
    CollapseWork,
    arrange_boxes,
    arrange_quantised,
    choose,
    fill_boxes,
    fill_quantised,
)
from .encode import as_vectors, place_groups_kernel, place_triangles_kernel
from .node import (
    TRIANGLES_MAX_BOXES,
    TRIANGLES_MAX_QUANTISED,
    WIDTH,
    Layout,
    WideMesh,
    WideTop,
    aligned_empty,
    triangle_faces,
)

_ERRORS = (
    "",
    "a leaf of the binary tree lists more than a leaf of this layout can",
    "children of a binary node must come after it",
    "the binary tree is too deep",
)


@dataclass(frozen=True)
class CollapseCost:
    """Weights of the surface area heuristic."""

    node: float = 1.0  # one step through a node
    unit: float = 1.0  # one unit of a leaf: a group of triangles, a triangle, or an entry


BOXES_COST = CollapseCost(1.0, 1.0)
QUANTISED_COST = CollapseCost(1.0, 0.35)
TOP_COST = CollapseCost(1.0, 4.0)  # an entry is a tree of its own


@wp.kernel(**KERNEL_OPTIONS)
def collapse_boxes_kernel(work: CollapseWork):
    """The plan of a tree in the layout BOXES (one thread)."""
    error = choose(work)
    if error == 0:
        error = arrange_boxes(work)
    work.found[0] = error


@wp.kernel(**KERNEL_OPTIONS)
def collapse_quantised_kernel(work: CollapseWork):
    """The plan of a tree in the layout QUANTISED (one thread)."""
    error = choose(work)
    if error == 0:
        error = arrange_quantised(work)
    work.found[0] = error


@wp.kernel(**KERNEL_OPTIONS)
def fill_boxes_kernel(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)):
    """Nodes of BOXES as planned, shape [16 n] (one thread)."""
    fill_boxes(work, nodes)


@wp.kernel(**KERNEL_OPTIONS)
def fill_quantised_kernel(work: CollapseWork, nodes: wp.array(dtype=wp.vec4)):
    """Nodes of QUANTISED as planned, shape [5 n] (one thread)."""
    fill_quantised(work, nodes)


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
    work = _start(binary, layout, cost or (BOXES_COST if boxes else QUANTISED_COST))
    work.positions = wp.array(positions, dtype=wp.vec3, device="cpu", copy=False)
    work.triangles = wp.array(triangles, dtype=wp.vec3i, device="cpu", copy=False)
    work.unit = WIDTH if boxes else 1
    work.clipped = binary.statistics.duplicate_count > 0
    if work.clipped:
        work.reach = _scratch(len(binary.nodes), float)
    tree, order = _collapse(work, binary, layout)
    blocks = aligned_empty((len(order) // work.unit, layout.triangle_words), np.float32)
    faces = triangle_faces(layout, blocks)
    faces[:] = order.reshape(faces.shape)
    place = place_groups_kernel if boxes else place_triangles_kernel
    wp.launch(place, dim=len(blocks), inputs=[as_vectors(blocks), work.positions, work.triangles], device="cpu")
    return WideMesh(**tree, triangles=blocks, triangle_count=len(triangles))


def collapse_entries(binary: BinaryTree, layout: Layout, cost: CollapseCost = TOP_COST) -> WideTop:
    """The wide tree over entries, from a binary tree over their boxes."""
    work = _start(binary, layout, cost)
    work.unit = 1
    tree, order = _collapse(work, binary, layout)
    return WideTop(**tree, order=order.copy())


def _start(binary: BinaryTree, layout: Layout, cost: CollapseCost) -> CollapseWork:
    if len(binary.nodes) == 0:
        raise ValueError("an empty tree cannot be collapsed")
    node_count, references = len(binary.nodes), len(binary.references)
    work = CollapseWork()
    work.nodes = _shared(np.ascontiguousarray(binary.nodes), float)
    work.references = _shared(np.ascontiguousarray(binary.references), int)
    work.node_count = node_count
    work.leaf_max = TRIANGLES_MAX_BOXES if layout is Layout.BOXES else TRIANGLES_MAX_QUANTISED
    work.cost = _scratch(8 * node_count, float)
    work.choice = _scratch(8 * node_count, wp.uint8)
    work.below = _scratch(node_count, int)
    leaves = (node_count + 1) // 2
    # pages are taken from the system when they are first written, so that these may be too large
    work.plan = _scratch(16 * max(leaves - 1, 1), int)
    work.order = _scratch(references + (7 * leaves if layout is Layout.BOXES else 0), int)
    work.centre = wp.vec3(*_centre(binary.nodes[0]).tolist())
    work.node_cost, work.unit_cost = cost.node, cost.unit
    work.found = wp.zeros(6, dtype=int, device="cpu")
    work.sah = wp.zeros(1, dtype=wp.float64, device="cpu")
    return work


def _collapse(work: CollapseWork, binary: BinaryTree, layout: Layout) -> tuple[dict[str, Any], np.ndarray]:
    """Run the passes; returns the fields of a `WideTree` and what its leaves list."""
    boxes = layout is Layout.BOXES
    wp.launch(collapse_boxes_kernel if boxes else collapse_quantised_kernel, dim=1, inputs=[work], device="cpu")
    error, node_count, listed, depth, leaf_count, reference_count = work.found.numpy().tolist()
    if error:
        raise ValueError(_ERRORS[error])
    nodes = aligned_empty((node_count, layout.node_words), layout.node_type)
    wp.launch(fill_boxes_kernel if boxes else fill_quantised_kernel, dim=1, inputs=[work, as_vectors(nodes)], device="cpu")
    root = binary.nodes[0]
    tree = {
        "layout": layout,
        "nodes": nodes,
        "centre": _centre(root),
        "box": np.stack([root[:3], root[4:7]]),
        "depth": depth,
        "leaf_count": leaf_count,
        "reference_count": reference_count,
        "sah": float(work.sah.numpy()[0]),
    }
    return tree, work.order.numpy()[:listed]


def _centre(root: np.ndarray) -> np.ndarray:
    return ((root[:3].astype(np.float64) + root[4:7]) / 2).astype(np.float32)


def _shared(array: np.ndarray, dtype: type) -> wp.array:
    """The memory of `array`, flat, as native code sees it."""
    return wp.array(array.reshape(-1), dtype=dtype, device="cpu", copy=False)


def _scratch(size: int, dtype: type) -> wp.array:
    return wp.empty(size, dtype=dtype, device="cpu")
