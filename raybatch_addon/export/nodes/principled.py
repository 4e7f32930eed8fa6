"""The Principled BSDF: layers of closures, each of which takes its share from those below."""

from __future__ import annotations

import math

from ...core.scene.description import Closure, ClosureKind
from . import ShaderNode, handles
from .bsdf import IOR_MIN, emission_strength, note_thin_film
from .mixture import BLACK, WHITE, Color, Mixture, saturated, times

KINDS = frozenset(
    {
        ClosureKind.TRANSPARENT,
        ClosureKind.EMISSION,
        ClosureKind.METAL,
        ClosureKind.GLASS,
        ClosureKind.DIELECTRIC,
        ClosureKind.LAYERED_DIFFUSE,
    }
)
# Reflectance at normal incidence stays below 1, where no finite index of refraction belongs to it (Blender's bound)
_REFLECTANCE_MAX = 0.99

# Inputs of layers that are not rendered: any of them above 0 is left out and said so
_LAYERS = ("Subsurface Weight", "Coat Weight", "Sheen Weight", "Diffuse Roughness", "Anisotropic", "Thin Wall")


@handles("ShaderNodeBsdfPrincipled")
def _principled(node: ShaderNode) -> Mixture:
    node.leave_out_links("Normal", "Coat Normal", "Tangent")
    for name in _LAYERS:
        if node.number(name) > 0:
            node.leave_out(name)
    note_thin_film(node)
    tint = node.color("Specular Tint")
    metallic = saturated(node.number("Metallic"))
    if tint != WHITE and metallic < 1:
        node.leave_out("Specular Tint (rendered on metal only)")
    emission = times(node.color("Emission Color"), emission_strength(node, "Emission Strength"))
    return principled_mixture(
        base=node.color("Base Color"),
        metallic=metallic,
        roughness=saturated(node.number("Roughness")),
        ior=max(node.number("IOR"), IOR_MIN),
        specular=max(node.number("Specular IOR Level"), 0.0),
        tint=(saturated(tint[0]), saturated(tint[1]), saturated(tint[2])),
        transmission=saturated(node.number("Transmission Weight")),
        alpha=saturated(node.number("Alpha")),
        emission=emission,
        multiscatter=node.node.distribution == "MULTI_GGX",
    )


def principled_mixture(
    *,
    base: Color,
    metallic: float,
    roughness: float,
    ior: float = 1.5,
    specular: float = 0.5,
    tint: Color = WHITE,
    transmission: float = 0.0,
    alpha: float = 1.0,
    emission: Color = BLACK,
    multiscatter: bool = True,
) -> Mixture:
    """The closures of a Principled BSDF.

    Transparency takes 1 - alpha of all; of the rest, metal takes `metallic`, of what is left glass takes
    `transmission`, and a dielectric coat above a diffuse base has the remainder. Emission lies above them.
    Glass reflects white; what it refracts is tinted by the square root of the base colour, since light
    crosses two surfaces on its way.
    """
    base = (saturated(base[0]), saturated(base[1]), saturated(base[2]))
    metal = alpha * metallic
    glass = alpha * (1.0 - metallic) * transmission
    plastic = alpha * (1.0 - metallic) * (1.0 - transmission)
    coat_ior = _coat_ior(ior, specular)
    refraction = (math.sqrt(base[0]), math.sqrt(base[1]), math.sqrt(base[2]))

    def lobe(
        kind: ClosureKind, color: Color, share: float, index: float = coat_ior, edge: Color = WHITE, refraction: Color = WHITE
    ) -> Closure:
        return Closure(kind, times(color, share), roughness, index, edge, refraction, share, multiscatter)

    closures = (
        Closure(ClosureKind.TRANSPARENT, times(WHITE, 1.0 - alpha)),
        Closure(ClosureKind.EMISSION, times(emission, alpha)),
        lobe(ClosureKind.METAL, base, metal, edge=tint),
        lobe(ClosureKind.GLASS, WHITE, glass, ior, refraction=refraction),
        lobe(ClosureKind.DIELECTRIC, WHITE if coat_ior != 1.0 else BLACK, plastic),
        lobe(ClosureKind.LAYERED_DIFFUSE, base, plastic),
    )
    return Mixture(closures, KINDS)


def _coat_ior(ior: float, specular: float) -> float:
    """The index of refraction whose reflectance at normal incidence is 2 `specular` times that of `ior`."""
    if specular == 0.5:
        return ior
    reflectance = min(2.0 * specular * ((ior - 1.0) / (ior + 1.0)) ** 2, _REFLECTANCE_MAX)
    root = math.sqrt(reflectance)
    scaled = (1.0 + root) / (1.0 - root)
    return 1.0 / scaled if ior < 1.0 else scaled
