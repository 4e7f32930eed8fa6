"""Bump, Normal Map, Tangent and Displacement: normals and tangents of surfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ....core.programs.builder import Constant, Value
from ....core.programs.ops.inputs.bump import NormalSpace
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.spaces import Space, VectorKind
from ....core.programs.ops.values.vector_math import VectorOperation
from ....core.programs.point import shift_width, wide_shift
from ..graph import AXES
from ..node import Graph, Node
from ..registry import values

if TYPE_CHECKING:
    import bpy

FILTER_WIDTH = 0.1  # Blender's filter width in a new node, which is that of the steps aside


def three_heights(graph: Graph, height, width: float = 1.0) -> tuple[Value, Value, Value]:
    """Results of `height()` here, and `width` steps aside along two axes."""
    before = graph.shift
    heights = []
    for shift in range(3):
        graph.shift = wide_shift(shift, width)
        heights.append(height())
    graph.shift = before
    return tuple(heights)


@values("ShaderNodeBump", family="Utilities", note="a bump within a height is that of the middle")
def bump(node: Node) -> Value:
    """A normal bent by a height."""
    graph, normal = node.graph, node.normal()
    if not node.linked("Height"):
        return normal
    # a step of a tenth of a pixel is what Blender calls 0.1
    width = shift_width(wide_shift(1, _filter_width(node) / FILTER_WIDTH))
    strength, distance = node.number("Strength"), node.number("Distance")
    heights = three_heights(graph, lambda: node.number("Height"), width)
    if all(height is heights[0] or (height.known and height.constant == heights[0].constant) for height in heights):
        return normal
    return node.op("bump", *heights, distance, strength, (-1.0 if node.node.invert else 1.0) / width, normal)


def _filter_width(node: Node) -> float:
    """The distance over which heights are compared [pixels]."""
    width = node.number("Filter Width", FILTER_WIDTH)
    if not width.known:
        node.warn("Filter Width that varies (0.1 pixels instead)")
        return FILTER_WIDTH
    # the decimal that was typed: a tenth is then a tenth
    return float(str(np.float32(width.number())))


@values("ShaderNodeNormalMap", family="Utilities", note="the original surface is taken to be the displaced one")
def normal_map(node: Node) -> Value:
    """A normal from a colour."""
    space = NormalSpace[node.node.space]
    color = node.color("Color")
    if getattr(node.node, "convention", "OPENGL") == "DIRECTX":
        red, green, blue = node.op("separate_xyz", color)
        color = node.op("combine_xyz", red, node.op("math", MathOperation.SUBTRACT, 0, 1.0, green, 0.0), blue)
    tangents = node.graph.collections.attribute("TANGENT", node.node.uv_map) if space == NormalSpace.TANGENT else -1
    return node.op("normal_map", space, tangents, color, node.number("Strength"))


@values("ShaderNodeTangent", family="Inputs")
def tangent(node: Node) -> Value:
    """A tangent around an axis, or along a UV map."""
    if node.node.direction_type == "RADIAL":
        return node.op("radial_tangent", AXES[node.node.axis], node.shift)
    return node.op("uv_tangent", node.graph.collections.attribute("TANGENT", node.node.uv_map))


@values("ShaderNodeDisplacement", family="Utilities")
def displacement(node: Node) -> Value:
    """A displacement along the normal."""
    raised = node.op("math", MathOperation.SUBTRACT, 0, node.number("Height"), node.number("Midlevel"), 0.0)
    along = node.op("displacement", int(node.node.space == "OBJECT"), node.normal())
    return node.times(along, node.op("math", MathOperation.MULTIPLY, 0, raised, node.number("Scale"), 0.0))


@values("ShaderNodeVectorDisplacement", family="Utilities", note="in tangent space it needs a UV map")
def vector_displacement(node: Node) -> Value:
    """A displacement along three axes: those of the world, of the object, or of tangent, normal and bitangent."""
    none = (0.0, 0.0, 0.0)

    def maths(operation: VectorOperation, a: Value, b: Value | Constant = none) -> Value:
        return node.op("vector_math", operation, a, b, none, 0.0)[0]

    midlevel, scale = node.as_vector(node.number("Midlevel")), node.number("Scale")
    raised = node.times(maths(VectorOperation.SUBTRACT, node.vector("Vector"), midlevel), scale)
    space = node.node.space
    if space == "WORLD":
        return raised
    if space == "TANGENT":
        attribute = node.graph.collections.attribute("TANGENT", "")
        tangent, _, sign = node.op("attribute", attribute, node.shift, 1)
        to_object = VectorKind.NORMAL, Space.WORLD, Space.OBJECT
        normal = node.op("vector_transform", *to_object, node.surface_normal())
        tangent = maths(VectorOperation.NORMALIZE, tangent)
        across = maths(VectorOperation.NORMALIZE, maths(VectorOperation.CROSS_PRODUCT, normal, tangent))
        parts = zip((tangent, normal, node.times(across, sign)), node.op("separate_xyz", raised), strict=True)
        along, up, aside = (node.times(axis, length) for axis, length in parts)
        raised = maths(VectorOperation.ADD, maths(VectorOperation.ADD, along, up), aside)
    return node.op("vector_transform", VectorKind.VECTOR, Space.OBJECT, Space.WORLD, raised)


def bump_from_displacement(graph: Graph, output: bpy.types.Node) -> None:
    """Bend the surface's normal by the displacement that is linked to the output node `output`."""
    node = Node(graph, output)
    normal = node.op("normals")[0]
    dot = VectorOperation.DOT_PRODUCT
    heights = three_heights(
        graph, lambda: node.op("vector_math", dot, node.vector("Displacement"), normal, (0.0, 0.0, 0.0), 0.0)[1]
    )
    graph.bend(node.op("bump", *heights, 1.0, 1.0, 1.0, normal))
    node.closure("surface_normal", graph.bumped)
