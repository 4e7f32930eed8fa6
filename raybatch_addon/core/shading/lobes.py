"""Closures as they are seen from wo: their colour with energy compensation and layering, and how often to sample them."""

import functools
from typing import NamedTuple

import warp as wp

from ..scene.description import ClosureKind
from .albedo import (
    AlbedoTables, coat_albedo, coat_fresnel, coat_fresnel_average, energy_compensation, glass_albedo, glass_compensation,
    reflection_albedo,
)  # fmt: skip
from .facets import make_facets
from .fresnel import f82_average, fresnel_dielectric, fresnel_f82, tinted_dielectric
from .materials import ClosureFeatures, ClosureRecord, ShadingFrame
from .microfacet import is_refraction_specular, is_specular

_K = ClosureKind
_DIFFUSE = wp.constant(int(_K.DIFFUSE))
_LAYERED_DIFFUSE = wp.constant(int(_K.LAYERED_DIFFUSE))
_GLOSSY = wp.constant(int(_K.GLOSSY))
_METAL = wp.constant(int(_K.METAL))
_DIELECTRIC = wp.constant(int(_K.DIELECTRIC))
_GLASS = wp.constant(int(_K.GLASS))
_TRANSPARENT = wp.constant(int(_K.TRANSPARENT))


class LobeFunctions(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    view: wp.Function  # (closures, c: int, albedo, frame, cos_o: float) -> Lobe
    reflectance: wp.Function  # (closures, c: int, cosine: float, entering: int) -> vec3: share of light that a facet reflects


@wp.struct
class Lobe:
    """A closure as it is seen from wo."""

    scale: wp.vec3  # weight times energy compensation and what the coat above lets through
    selection: float  # its albedo, about, summed over the channels: how often it is sampled


@wp.func
def relative_index(ior: float, entering: int) -> float:
    """Index of refraction of the far side relative to that of the side of wo."""
    if entering == 0:
        return 1.0 / ior
    return ior


@wp.func
def _sum(v: wp.vec3) -> float:
    return v[0] + v[1] + v[2]


@functools.cache
def make_lobes(features: ClosureFeatures) -> LobeFunctions:
    """The functions for closures of `features.kinds`."""
    has = features.has
    has_diffuse, has_layered = has(_K.DIFFUSE), has(_K.LAYERED_DIFFUSE)
    has_glossy, has_metal, has_dielectric = has(_K.GLOSSY), has(_K.METAL), has(_K.DIELECTRIC)
    has_mirror = has_glossy or has_metal or has_dielectric
    has_glass, has_transparent = has(_K.GLASS), has(_K.TRANSPARENT)

    mean_alpha = make_facets(features).alpha
    alike = not has(_K.ANISOTROPIC)

    @wp.func
    def table_roughness(closures: wp.array(dtype=ClosureRecord), c: int) -> float:
        """Roughness of isotropic facets of as many slopes."""
        roughness = closures[c].roughness
        if wp.static(not alike):
            alpha = mean_alpha(closures, c)
            if alpha != roughness * roughness:
                return wp.sqrt(alpha)
        return roughness

    @wp.func
    def coat_reflects(closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, cos_o: float) -> float:
        """Albedo of the coat above a LAYERED_DIFFUSE closure."""
        roughness = closures[c].roughness
        ior = closures[c].ior
        if is_specular(roughness * roughness):
            return fresnel_dielectric(cos_o, ior)
        mean = wp.vec3(0.0)
        if closures[c].multiscatter == 1:
            mean = wp.vec3(coat_fresnel_average(tables, ior))
        factor = energy_compensation(tables, roughness, cos_o, mean)[0]
        return coat_albedo(tables, roughness, ior, cos_o) * factor

    @wp.func
    def compensated(
        closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, roughness: float, cos_o: float, mean: wp.vec3
    ) -> wp.vec4:
        """(energy compensation, single-scattering albedo) of GGX with F = 1, for facets that reflect `mean`."""
        if is_specular(roughness * roughness):
            return wp.vec4(1.0, 1.0, 1.0, 1.0)
        bounded = wp.vec3(0.0)
        if closures[c].multiscatter == 1:
            bounded = wp.min(mean, wp.vec3(1.0))
        f = energy_compensation(tables, roughness, cos_o, bounded)
        return wp.vec4(f[0], f[1], f[2], reflection_albedo(tables, roughness, cos_o))

    @wp.func
    def reflectance(closures: wp.array(dtype=ClosureRecord), c: int, cosine: float, entering: int) -> wp.vec3:
        """Share of light that a facet of closure `c` reflects, met at `cosine`."""
        kind = closures[c].kind
        f = wp.vec3(1.0)
        if wp.static(has_metal):
            if kind == _METAL:
                f = fresnel_f82(closures[c].colour, closures[c].edge, cosine)
        if wp.static(has_dielectric or has_glass):
            if kind == _DIELECTRIC or kind == _GLASS:
                eta = closures[c].ior
                if kind == _GLASS:
                    eta = relative_index(eta, entering)
                f = tinted_dielectric(fresnel_dielectric(cosine, eta), eta, closures[c].edge)
        return f

    @wp.func
    def view_lobe(
        closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, frame: ShadingFrame, cos_o: float
    ) -> Lobe:
        """Closure `c` seen at `cos_o` to the facets' normal."""
        lobe = Lobe()
        kind = closures[c].kind
        weight = closures[c].weight
        albedo = wp.vec3(0.0)
        if wp.static(has_diffuse):
            if kind == _DIFFUSE:
                lobe.scale = weight
                albedo = weight
        if wp.static(has_layered):
            if kind == _LAYERED_DIFFUSE:
                lobe.scale = wp.max(1.0 - coat_reflects(closures, c, tables, cos_o), 0.0) * weight
                albedo = lobe.scale
        if wp.static(has_mirror):
            if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC:
                roughness = table_roughness(closures, c)
                mean = closures[c].colour
                seen = wp.vec3(1.0)
                if wp.static(has_metal):
                    if kind == _METAL:
                        mean = f82_average(closures[c].colour, closures[c].edge)
                        seen = fresnel_f82(closures[c].colour, closures[c].edge, cos_o)
                if wp.static(has_dielectric):
                    if kind == _DIELECTRIC:
                        ior = closures[c].ior
                        mean = tinted_dielectric(coat_fresnel_average(tables, ior), ior, closures[c].edge)
                        seen_white = fresnel_dielectric(cos_o, ior)
                        if not is_specular(roughness * roughness):
                            seen_white = coat_fresnel(tables, roughness, ior, cos_o)
                        seen = tinted_dielectric(seen_white, ior, closures[c].edge)
                m = compensated(closures, c, tables, roughness, cos_o, mean)
                lobe.scale = wp.cw_mul(weight, wp.vec3(m[0], m[1], m[2]))
                albedo = m[3] * wp.cw_mul(lobe.scale, seen)
        if wp.static(has_glass):
            if kind == _GLASS:
                roughness = closures[c].roughness
                eta = relative_index(closures[c].ior, frame.entering)
                lobe.scale = weight
                # where refraction is not blurred, facets do not hide light from each other either
                if closures[c].multiscatter == 1 and not is_refraction_specular(roughness * roughness, eta):
                    bounded = wp.min(closures[c].colour, wp.vec3(1.0))
                    lobe.scale = wp.cw_mul(weight, glass_compensation(tables, roughness, eta, cos_o, bounded))
                albedo = weight
        if wp.static(has_transparent):
            if kind == _TRANSPARENT:
                lobe.scale = weight
                albedo = weight
        lobe.selection = _sum(albedo)
        return lobe

    return LobeFunctions(view_lobe, reflectance)
