"""Diffuse, Translucent, Transparent, Sheen and Holdout."""

from __future__ import annotations

from ...core.scene.description import ClosureKind
from ...core.shading.nodes.builder import Value
from .node import Node
from .registry import shader

_K = ClosureKind


@shader("ShaderNodeBsdfDiffuse", kinds=lambda node: (_K.DIFFUSE, _K.ROUGH_DIFFUSE) if node.used("Roughness") else (_K.DIFFUSE,))
def diffuse(node: Node, weight: Value) -> None:
    """Lambert's law, or with roughness Oren and Nayar's."""
    color = node.color("Color")
    if node.used("Roughness"):
        node.closure("rough_diffuse", node.times(weight, color), color, node.number("Roughness"), node.own_normal())
    else:
        node.closure("diffuse", node.times(weight, color), node.own_normal())


@shader("ShaderNodeSubsurfaceScattering", kinds=(_K.DIFFUSE,), note="rendered as diffuse reflection of the same colour")
def subsurface(node: Node, weight: Value) -> None:
    """Light that comes out where it went in."""
    node.warn("scattering below the surface is rendered as diffuse reflection of the same colour; this is the shader")
    node.closure("diffuse", node.times(weight, node.color("Color")), node.own_normal())


@shader("ShaderNodeBsdfTranslucent", kinds=(_K.TRANSLUCENT,))
def translucent(node: Node, weight: Value) -> None:
    """Diffuse light on the other side."""
    node.closure("translucent", node.times(weight, node.color("Color")), node.own_normal())


@shader("ShaderNodeBsdfTransparent", kinds=(_K.TRANSPARENT,))
def transparent(node: Node, weight: Value) -> None:
    """Straight passage."""
    node.closure("transparent", node.times(weight, node.color("Color")))


@shader("ShaderNodeBsdfSheen", kinds=lambda node: (_K.VELVET if node.node.distribution == "ASHIKHMIN" else _K.SHEEN,))
def sheen(node: Node, weight: Value) -> None:
    """Fibres, or Ashikhmin's velvet."""
    op = "velvet" if node.node.distribution == "ASHIKHMIN" else "sheen"
    node.closure(op, node.times(weight, node.color("Color")), node.number("Roughness"), node.own_normal())


@shader("ShaderNodeHoldout", kinds=(_K.HOLDOUT,))
def holdout(node: Node, weight: Value) -> None:
    """A hole in the picture."""
    node.closure("holdout", weight)
