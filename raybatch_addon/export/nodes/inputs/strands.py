"""Curves Info and Point Info: what strands and points of point clouds say of themselves."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.spaces import Space, VectorKind
from ..node import Node
from ..registry import values
from .attributes import mesh_attribute

_HAIR = {
    "Is Strand": "is_strand",
    "Intercept": "intercept",
    "Length": "length",
    "Thickness": "thickness",
    "Random": "random",
}


@values("ShaderNodeHairInfo", family="Inputs", note="lengths and thicknesses are those before the object's scale")
def hair_info(node: Node) -> dict[str, Value]:
    """The strand that is met; 0 on meshes."""
    outputs = {output: mesh_attribute(node, "CURVE", name)[1] for output, name in _HAIR.items() if node.wants(output)}
    if node.wants("Tangent Normal"):
        outputs["Tangent Normal"] = node.op("curve_tangent_normal")
    return outputs


@values("ShaderNodePointInfo", family="Inputs", note="the radius is that before the object's scale")
def point_info(node: Node) -> dict[str, Value]:
    """The point of a point cloud that is met; 0 on others."""
    outputs = {}
    if node.wants("Position"):
        own = mesh_attribute(node, "CURVE", "point_position")[0]
        outputs["Position"] = node.op("vector_transform", VectorKind.POINT, Space.OBJECT, Space.WORLD, own)
    for output, name in (("Radius", "point_radius"), ("Random", "point_random")):
        if node.wants(output):
            outputs[output] = mesh_attribute(node, "CURVE", name)[1]
    return outputs
