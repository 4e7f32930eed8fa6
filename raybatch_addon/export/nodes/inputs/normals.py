"""Bump, Normal Map, Tangent and Displacement: normals and tangents of surfaces."""

from __future__ import annotations

from typing import Any

from ....core.programs.builder import Value
from ....core.programs.ops.inputs.bump import NormalSpace
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.vector_math import VectorOperation
from ..node import Graph, Node
from ..registry import values

_FILTER_WIDTH = 0.1  # Blender's filter width, which is that of the steps aside
_AXES = {"X": 0, "Y": 1, "Z": 2}


def three_heights(graph: Graph, height) -> tuple[Value, Value, Value]:
    """Results of `height()` here, and one step aside along two axes."""
    before = graph.shift
    heights = []
    for shift in range(3):
        graph.shift = shift
        heights.append(height())
    graph.shift = before
    return tuple(heights)


@values(
    "ShaderNodeBump",
    family="Utilities",
    note="heights are compared over a tenth of a pixel, whatever the filter width says; a bump within a height is that "
    "of the middle",
)
def bump(node: Node) -> Value:
    """A normal bent by a height."""
    graph, normal = node.graph, node.normal()
    if not node.linked("Height"):
        return normal
    if node.has("Filter Width"):
        width = node.number("Filter Width")
        if not width.known or abs(width.number() - _FILTER_WIDTH) > 1e-6:
            node.warn("Filter Width (0.1 pixels instead)")
    strength, distance = node.number("Strength"), node.number("Distance")
    heights = three_heights(graph, lambda: node.number("Height"))
    if all(height is heights[0] or (height.known and height.constant == heights[0].constant) for height in heights):
        return normal
    return node.op("bump", *heights, distance, strength, -1.0 if node.node.invert else 1.0, normal)


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
        return node.op("radial_tangent", _AXES[node.node.axis], node.shift)
    return node.op("uv_tangent", node.graph.collections.attribute("TANGENT", node.node.uv_map))


@values("ShaderNodeDisplacement", family="Utilities", note="rendered as bump")
def displacement(node: Node) -> Value:
    """A displacement along the normal."""
    raised = node.op("math", MathOperation.SUBTRACT, 0, node.number("Height"), node.number("Midlevel"), 0.0)
    along = node.op("displacement", int(node.node.space == "OBJECT"), node.normal())
    return node.times(along, node.op("math", MathOperation.MULTIPLY, 0, raised, node.number("Scale"), 0.0))


def bump_from_displacement(graph: Graph, output: Any) -> None:
    """Bend the surface's normal by the displacement that is linked to the output node `output`."""
    node = Node(graph, output)
    normal = node.op("normals")[0]
    dot = VectorOperation.DOT_PRODUCT
    heights = three_heights(
        graph, lambda: node.op("vector_math", dot, node.vector("Displacement"), normal, (0.0, 0.0, 0.0), 0.0)[1]
    )
    graph.bend(node.op("bump", *heights, 1.0, 1.0, 1.0, normal))
    node.closure("surface_normal", graph.bumped)
