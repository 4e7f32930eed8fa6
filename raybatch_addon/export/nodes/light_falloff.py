"""Light Falloff: light that fades with distance otherwise than light does."""

from __future__ import annotations

from ...core.shading.nodes.builder import Value
from .node import Node
from .registry import values


@values("ShaderNodeLightFalloff", family="Utilities")
def light_falloff(node: Node) -> dict[str, Value]:
    """Strengths by which light falls with the square of the distance, with the distance, and not at all; that of suns never falls."""
    quadratic, linear, constant = node.op("light_falloff", node.number("Strength"), node.number("Smooth"))
    return {"Quadratic": quadratic, "Linear": linear, "Constant": constant}
