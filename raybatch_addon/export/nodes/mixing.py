"""Mix Shader and Add Shader."""

from __future__ import annotations

from . import ShaderNode, handles
from .mixture import Mixture, saturated


@handles("ShaderNodeMixShader")
def _mix(node: ShaderNode) -> Mixture:
    share = saturated(node.number("Fac"))
    return node.shader(1).scaled(1.0 - share) + node.shader(2).scaled(share)


@handles("ShaderNodeAddShader")
def _add(node: ShaderNode) -> Mixture:
    return node.shader(0) + node.shader(1)
