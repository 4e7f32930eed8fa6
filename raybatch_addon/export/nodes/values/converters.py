"""Vectors taken apart, put together, moved and turned; the falloff of light."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.values.rotate import MappingKind, RotationKind
from ....core.programs.ops.values.spaces import Space, VectorKind
from ..node import Node, own_value
from ..registry import values


@values("ShaderNodeCombineXYZ", family="Utilities")
def combine_xyz(node: Node) -> Value:
    """A vector from three numbers."""
    return node.op("combine_xyz", node.number(0), node.number(1), node.number(2))


@values("ShaderNodeSeparateXYZ", family="Utilities")
def separate_xyz(node: Node) -> dict[str, Value]:
    """A vector as three numbers."""
    return dict(zip("XYZ", node.op("separate_xyz", node.vector(0))))


@values("ShaderNodeMapping", family="Utilities")
def mapping(node: Node) -> Value:
    """Coordinates scaled, rotated and moved."""
    operands = node.vector("Vector"), node.vector("Location"), node.vector("Rotation"), node.vector("Scale")
    return node.op("mapping", MappingKind[node.node.vector_type], *operands)


@values("ShaderNodeVectorRotate", family="Utilities")
def vector_rotate(node: Node) -> Value:
    """A vector turned around a point."""
    how = RotationKind[node.node.rotation_type], node.node.invert
    vectors = (node.vector(key) for key in ("Vector", "Center", "Axis"))
    return node.op("vector_rotate", *how, *vectors, node.number("Angle"), node.vector("Rotation"))


@values("ShaderNodeNormal", family="Utilities")
def normal(node: Node) -> dict[str, Value]:
    """A direction, and its cosine to a normal."""
    direction, cosine = node.op("normal", own_value(node.node.outputs["Normal"]), node.vector("Normal"))
    return {"Normal": direction, "Dot": cosine}


@values("ShaderNodeVectorTransform", family="Utilities")
def vector_transform(node: Node) -> Value:
    """A vector in another space."""
    settings = node.node
    how = VectorKind[settings.vector_type], Space[settings.convert_from], Space[settings.convert_to]
    return node.op("vector_transform", *how, node.vector("Vector"))


@values("ShaderNodeRadialTiling", family="Utilities")
def radial_tiling(node: Node) -> dict[str, Value]:
    """Segments around the origin."""
    outputs = node.op(
        "radial_tiling", node.node.normalize, node.vector("Vector"), node.number("Sides"), node.number("Roundness")
    )
    return dict(zip(("Segment Coordinates", "Segment ID", "Segment Width", "Segment Rotation"), outputs))
