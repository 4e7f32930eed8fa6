"""Values, colours and texture coordinates."""

from __future__ import annotations

from ...core.shading.nodes.builder import Value
from .node import Node, own_value
from .registry import values


@values("ShaderNodeValue", "ShaderNodeRGB", family="Inputs")
def constant(node: Node) -> Value:
    """The number or colour of the node itself."""
    return own_value(node.node.outputs[0])


@values("ShaderNodeTexCoord", family="Inputs")
def texture_coordinates(node: Node) -> dict[str, Value]:
    """Coordinates by output."""
    outputs = {}
    if node.wants("Generated"):
        outputs["Generated"] = node.coordinates()
    if node.wants("Object"):
        outputs["Object"] = node.op("object_coordinates", node.shift)
    if node.wants("UV"):
        outputs["UV"] = node.uv()
    return outputs
