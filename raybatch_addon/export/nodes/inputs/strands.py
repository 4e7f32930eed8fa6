"""Curves Info and Point Info: what strands and points of point clouds say of themselves."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.spaces import Space, VectorKind
from ....core.programs.ops.values.vector_math import VectorOperation
from ..node import Node
from ..registry import values
from .attributes import mesh_attribute

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_NONE = (0.0, 0.0, 0.0)
_HAIR = {
    "Is Strand": "is_strand",
    "Intercept": "intercept",
    "Length": "length",
    "Thickness": "thickness",
    "Random": "random",
}


def _scaled(node: Node, size: Value) -> Value:
    """`size` times the scale of the object: the cube root of what becomes of a volume there. Cycles scales so the only
    object that has its data, and no others.
    """

    def moved(axis: tuple[float, float, float]) -> Value:
        return node.op("vector_transform", VectorKind.VECTOR, Space.OBJECT, Space.WORLD, node.constant(axis))

    across = node.op("vector_math", VectorOperation.CROSS_PRODUCT, moved(_X), moved(_Y), _NONE, 0.0)[0]
    volume = node.op("vector_math", VectorOperation.DOT_PRODUCT, across, moved(_Z), _NONE, 0.0)[1]
    positive = node.op("math", MathOperation.ABSOLUTE, False, volume, 0.0, 0.0)
    scale = node.op("math", MathOperation.POWER, False, positive, 1 / 3, 0.0)
    return node.op("math", MathOperation.MULTIPLY, False, size, scale, 0.0)


@values("ShaderNodeHairInfo", family="Inputs", note="lengths are those before the object's scale, as in Cycles")
def hair_info(node: Node) -> dict[str, Value]:
    """The strand that is met; 0 on meshes."""
    outputs = {output: mesh_attribute(node, "CURVE", name)[1] for output, name in _HAIR.items() if node.wants(output)}
    if node.wants("Thickness"):
        outputs["Thickness"] = _scaled(node, outputs["Thickness"])
    if node.wants("Tangent Normal"):
        outputs["Tangent Normal"] = node.op("curve_tangent_normal")
    return outputs


@values("ShaderNodePointInfo", family="Inputs")
def point_info(node: Node) -> dict[str, Value]:
    """The point of a point cloud that is met; 0 on others."""
    outputs = {}
    if node.wants("Position"):
        own = mesh_attribute(node, "CURVE", "point_position")[0]
        outputs["Position"] = node.op("vector_transform", VectorKind.POINT, Space.OBJECT, Space.WORLD, own)
    for output, name in (("Radius", "point_radius"), ("Random", "point_random")):
        if node.wants(output):
            outputs[output] = mesh_attribute(node, "CURVE", name)[1]
    if node.wants("Radius"):
        outputs["Radius"] = _scaled(node, outputs["Radius"])
    return outputs
