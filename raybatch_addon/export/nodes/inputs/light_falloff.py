"""Light Falloff: light that fades with the distance, its square, or not at all."""

from __future__ import annotations

from ....core.programs.builder import Value
from ..node import Node
from ..registry import values


@values("ShaderNodeLightFalloff", family="Utilities")
def light_falloff(node: Node) -> dict[str, Value]:
    """Strengths for light that falls with the square of the distance, with the distance, and not at all.

    A sun's light never falls.
    """
    quadratic, linear, constant = node.op("light_falloff", node.number("Strength"), node.number("Smooth"))
    return {"Quadratic": quadratic, "Linear": linear, "Constant": constant}
