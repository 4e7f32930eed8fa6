"""Diffuse, Translucent, Transparent, Ray Portal, Sheen, Toon and Holdout."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.closures.soft import SubsurfaceMethod
from ....core.scene.description import ClosureKind
from ..node import Node
from ..registry import shader

_K = ClosureKind


@shader(
    "ShaderNodeBsdfDiffuse",
    kinds=lambda node: (_K.DIFFUSE, _K.ROUGH_DIFFUSE) if node.used("Roughness") else (_K.DIFFUSE,),
)
def diffuse(node: Node, weight: Value) -> None:
    """Diffuse reflection by Lambert's law, or with roughness by Oren and Nayar's."""
    color = node.color("Color")
    if node.used("Roughness"):
        node.closure("rough_diffuse", node.times(weight, color), color, node.number("Roughness"), node.own_normal())
    else:
        node.closure("diffuse", node.times(weight, color), node.own_normal())


_METHODS = {"RANDOM_WALK": SubsurfaceMethod.RANDOM_WALK, "RANDOM_WALK_SKIN": SubsurfaceMethod.SKIN}


def subsurface_method(node: Node, name: str) -> SubsurfaceMethod:
    """Rendered equivalent of the node's method `name`."""
    if name == "BURLEY":
        node.warn("Christensen-Burley's scattering below the surface is rendered as a random walk; this is the method")
    return _METHODS.get(name, SubsurfaceMethod.LEGACY)


@shader(
    "ShaderNodeSubsurfaceScattering",
    kinds=(_K.SUBSURFACE, _K.DIFFUSE),
    note="Christensen-Burley's is rendered as a random walk",
)
def subsurface(node: Node, weight: Value) -> None:
    """Subsurface scattering."""
    radius = node.times(node.vector("Radius"), node.as_vector(node.number("Scale")))
    roughness = node.op("roughness_of_alpha", node.number("Roughness"))
    node.closure(
        "subsurface",
        weight,
        node.color("Color"),
        radius,
        node.number("Anisotropy"),
        subsurface_method(node, node.node.falloff),
        roughness,
        node.number("IOR"),
        node.own_normal(),
    )


@shader("ShaderNodeBsdfTranslucent", kinds=(_K.TRANSLUCENT,))
def translucent(node: Node, weight: Value) -> None:
    """Diffuse light on the other side."""
    node.closure("translucent", node.times(weight, node.color("Color")), node.own_normal())


@shader("ShaderNodeBsdfTransparent", kinds=(_K.TRANSPARENT,))
def transparent(node: Node, weight: Value) -> None:
    """Straight passage of light."""
    node.closure("transparent", node.times(weight, node.color("Color")))


@shader("ShaderNodeBsdfRayPortal", kinds=(_K.RAY_PORTAL,))
def ray_portal(node: Node, weight: Value) -> None:
    """Passage to elsewhere."""
    color = node.times(weight, node.color("Color"))
    node.closure("ray_portal", color, int(node.linked("Position")), node.vector("Position"), node.vector("Direction"))


@shader("ShaderNodeBsdfSheen", kinds=lambda node: (_K.VELVET if node.node.distribution == "ASHIKHMIN" else _K.SHEEN,))
def sheen(node: Node, weight: Value) -> None:
    """Fibres, or Ashikhmin's velvet."""
    op = "velvet" if node.node.distribution == "ASHIKHMIN" else "sheen"
    node.closure(op, node.times(weight, node.color("Color")), node.number("Roughness"), node.own_normal())


@shader("ShaderNodeBsdfToon", kinds=(_K.TOON,))
def toon(node: Node, weight: Value) -> None:
    """A cone of light with an edge."""
    mirrors = int(node.node.component == "GLOSSY")
    color = node.times(weight, node.color("Color"))
    node.closure("toon", color, mirrors, node.number("Size"), node.number("Smooth"), node.own_normal())


@shader("ShaderNodeHoldout", kinds=(_K.HOLDOUT,))
def holdout(node: Node, weight: Value) -> None:
    """A hole in the picture."""
    node.closure("holdout", weight)
