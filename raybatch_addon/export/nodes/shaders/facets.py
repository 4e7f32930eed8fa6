"""Glossy, Metallic, Glass and Refraction."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.closures.facets import Distribution
from ....core.scene.description import ClosureKind
from ..node import WHITE, Node
from ..registry import shader

_K = ClosureKind
_NONE = (0.0, 0.0, 0.0)


def distribution(node: Node) -> Distribution:
    """Distribution of the node's facets."""
    return Distribution.__members__.get(node.node.distribution, Distribution.GGX)


def anisotropy(node: Node, aspect_op: str, name: str, rotation: str) -> tuple[Value, Value]:
    """Aspect and tangent; 1 and 0 for isotropic facets."""
    if not node.used(name):
        return node.constant(1.0), node.constant(_NONE)
    tangent = node.tangent()
    if node.used(rotation):
        tangent = node.op("rotate_tangent", tangent, node.own_normal(), node.number(rotation))
    return node.op(aspect_op, node.number(name)), tangent


def thin_film(node: Node) -> tuple[Value, Value]:
    """Thickness [nm] and index of the film on the facets; thickness 0 if there is none."""
    if not node.used("Thin Film Thickness"):
        return node.constant(0.0), node.constant(1.0)
    return node.number("Thin Film Thickness"), node.number("Thin Film IOR")


def _kinds(kind: ClosureKind, anisotropic: str = ""):
    def kinds(node: Node) -> list[ClosureKind]:
        found = [kind]
        if distribution(node) == Distribution.BECKMANN:
            found.append(_K.BECKMANN)
        if anisotropic and node.used(anisotropic):
            found.append(_K.ANISOTROPIC)
        if node.has("Thin Film Thickness") and node.used("Thin Film Thickness"):
            found.append(_K.THIN_FILM)
        return found

    return kinds


def _glossy_kind(node: Node) -> ClosureKind:
    return _K.ASHIKHMIN_SHIRLEY if node.node.distribution == "ASHIKHMIN_SHIRLEY" else _K.GLOSSY


@shader("ShaderNodeBsdfAnisotropic", kinds=lambda node: _kinds(_glossy_kind(node), "Anisotropy")(node))
def glossy(node: Node, weight: Value) -> None:
    """Facets that reflect all light."""
    color = node.color("Color")
    aspect, tangent = anisotropy(node, "glossy_aspect", "Anisotropy", "Rotation")
    weight, roughness, normal = node.times(weight, color), node.number("Roughness"), node.own_normal()
    if _glossy_kind(node) == _K.ASHIKHMIN_SHIRLEY:
        node.closure("ashikhmin_shirley", weight, roughness, aspect, tangent, normal)
    else:
        node.closure("glossy", weight, color, distribution(node), roughness, aspect, tangent, normal)


def _is_conductor(node: Node) -> bool:
    return getattr(node.node, "fresnel_type", "F82") == "PHYSICAL_CONDUCTOR"


@shader(
    "ShaderNodeBsdfMetallic",
    kinds=lambda node: _kinds(_K.CONDUCTOR if _is_conductor(node) else _K.METAL, "Anisotropy")(node),
)
def metallic(node: Node, weight: Value) -> None:
    """Metal, by colour and tint or by its indices."""
    aspect, tangent = anisotropy(node, "principled_aspect", "Anisotropy", "Rotation")
    facets = (distribution(node), node.number("Roughness"), aspect, tangent, node.own_normal(), *thin_film(node))
    if _is_conductor(node):
        node.closure("conductor", weight, node.vector("IOR"), node.vector("Extinction"), *facets)
    else:
        node.closure("metal", weight, node.color("Base Color"), node.color("Edge Tint"), *facets)


@shader("ShaderNodeBsdfGlass", kinds=_kinds(_K.GLASS))
def glass(node: Node, weight: Value) -> None:
    """Facets that reflect and refract."""
    color = node.color("Color")
    node.closure(
        "glass",
        node.times(weight, color),
        WHITE,
        color,
        WHITE,
        distribution(node),
        node.number("Roughness"),
        node.number("IOR"),
        node.own_normal(),
        *thin_film(node),
    )


@shader("ShaderNodeBsdfRefraction", kinds=_kinds(_K.REFRACTION))
def refraction(node: Node, weight: Value) -> None:
    """Facets that refract all light."""
    facets = (distribution(node), node.number("Roughness"), node.number("IOR"), node.own_normal())
    node.closure("refraction", node.times(weight, node.color("Color")), *facets)
