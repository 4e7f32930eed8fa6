"""Nodes of one closure: Diffuse, Glossy, Metallic, Glass, Transparent and Emission."""

from __future__ import annotations

from ...core.scene.description import ClosureKind
from . import ShaderNode, handles
from .graph import NotUnderstood, node_label
from .mixture import Color, Mixture, saturated, single, times

# Blender's smallest index of refraction, which keeps 1 / ior finite
IOR_MIN = 1e-5


@handles("ShaderNodeBsdfDiffuse")
def _diffuse(node: ShaderNode) -> Mixture:
    node.leave_out_links("Normal")
    if node.number("Roughness") > 0:
        node.leave_out("Roughness")
    return single(ClosureKind.DIFFUSE, node.color("Color"))


@handles("ShaderNodeBsdfAnisotropic")
def _glossy(node: ShaderNode) -> Mixture:
    multiscatter = _lobe(node, "Anisotropy")
    roughness = saturated(node.number("Roughness"))
    return single(ClosureKind.GLOSSY, node.color("Color"), roughness=roughness, multiscatter=multiscatter)


@handles("ShaderNodeBsdfMetallic")
def _metallic(node: ShaderNode) -> Mixture:
    if node.node.fresnel_type != "F82":
        raise NotUnderstood(f"{node_label(node.node)} with physical conductors")
    multiscatter = _lobe(node, "Anisotropy")
    note_thin_film(node)
    base = _at_most_one(node.color("Base Color"))
    edge = _at_most_one(node.color("Edge Tint"))
    roughness = saturated(node.number("Roughness"))
    return single(ClosureKind.METAL, base, edge=edge, roughness=roughness, multiscatter=multiscatter)


@handles("ShaderNodeBsdfGlass")
def _glass(node: ShaderNode) -> Mixture:
    multiscatter = _lobe(node)
    note_thin_film(node)
    roughness, ior = saturated(node.number("Roughness")), max(node.number("IOR"), IOR_MIN)
    return single(ClosureKind.GLASS, node.color("Color"), roughness=roughness, ior=ior, multiscatter=multiscatter)


@handles("ShaderNodeBsdfTransparent")
def _transparent(node: ShaderNode) -> Mixture:
    return single(ClosureKind.TRANSPARENT, node.color("Color"))


@handles("ShaderNodeEmission")
def _emission(node: ShaderNode) -> Mixture:
    return single(ClosureKind.EMISSION, times(node.color("Color"), emission_strength(node, "Strength")))


def emission_strength(node: ShaderNode, name: str) -> float:
    """The input `name`; below 0, which Blender allows, it is taken as 0 and noted."""
    strength = node.number(name)
    if strength < 0:
        node.leave_out(f"negative {name}")
    return max(strength, 0.0)


def note_thin_film(node: ShaderNode) -> None:
    """Notes a thin film, which is not rendered."""
    if node.number("Thin Film Thickness") > 0:
        node.leave_out("Thin Film")


def _at_most_one(color: Color) -> Color:
    return saturated(color[0]), saturated(color[1]), saturated(color[2])


def _lobe(node: ShaderNode, anisotropy: str | None = None) -> bool:
    """Notes what of a microfacet lobe is not rendered; whether its facets scatter more than once."""
    node.leave_out_links("Normal")
    distribution = node.node.distribution
    if distribution not in ("GGX", "MULTI_GGX"):
        node.leave_out(f"the distribution {distribution.replace('_', '-').title()} (GGX instead)")
    if anisotropy is not None and node.number(anisotropy) != 0:
        node.leave_out(anisotropy)
    return distribution == "MULTI_GGX"
