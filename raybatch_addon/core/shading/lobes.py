"""Closures as they are seen from wo: their colour with energy compensation and layering, and how often to sample them."""

import functools
from typing import NamedTuple

import warp as wp

from ..scene.description import ClosureKind
from .albedo import AlbedoTables, coat_albedo, coat_fresnel_average, energy_compensation, glass_albedo, reflection_albedo
from .materials import ClosureFeatures, ClosureRecord, ShadingFrame
from .microfacet import fresnel_dielectric, fresnel_schlick, is_refraction_specular, is_specular

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
    mirror_fresnel: wp.Function  # (closures, c: int, cosine: float) -> vec3: reflectance of a facet


@wp.struct
class Lobe:
    """A closure as it is seen from wo."""

    scale: wp.vec3  # weight times energy compensation and what the coat above lets through; METAL: without its colour
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
    has_glass, has_transparent = has(_K.GLASS), has(_K.TRANSPARENT)

    @wp.func
    def coat_reflects(closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, cos_o: float) -> wp.vec2:
        """(albedo of the coat, energy compensation of its lobe)."""
        roughness = closures[c].roughness
        ior = closures[c].ior
        if is_specular(roughness * roughness):
            return wp.vec2(fresnel_dielectric(cos_o, ior), 1.0)
        mean = wp.vec3(0.0)
        if closures[c].colour_scale > 0.0:
            mean = wp.vec3(coat_fresnel_average(tables, ior))
        factor = energy_compensation(tables, roughness, cos_o, mean)[0]
        return wp.vec2(coat_albedo(tables, roughness, ior, cos_o) * factor, factor)

    @wp.func
    def mirror_albedo(
        closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, cos_o: float, mean: wp.vec3
    ) -> wp.vec4:
        """(energy compensation, single-scattering albedo) of GGX with F = 1, for facets that reflect `mean`."""
        roughness = closures[c].roughness
        if is_specular(roughness * roughness):
            return wp.vec4(1.0, 1.0, 1.0, 1.0)
        colour = closures[c].colour_scale * mean
        bounded = wp.min(colour, wp.vec3(1.0))
        f = energy_compensation(tables, roughness, cos_o, bounded)
        return wp.vec4(f[0], f[1], f[2], reflection_albedo(tables, roughness, cos_o))

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
                lobe.scale = wp.max(1.0 - coat_reflects(closures, c, tables, cos_o)[0], 0.0) * weight
                albedo = lobe.scale
        if wp.static(has_glossy):
            if kind == _GLOSSY:
                m = mirror_albedo(closures, c, tables, cos_o, weight)
                lobe.scale = wp.cw_mul(weight, wp.vec3(m[0], m[1], m[2]))
                albedo = m[3] * lobe.scale
        if wp.static(has_metal):
            if kind == _METAL:
                edge = closures[c].edge
                # the hemisphere's mean of (1 - cos)^5 is 1 / 21
                m = mirror_albedo(closures, c, tables, cos_o, weight + (edge - weight) / 21.0)
                lobe.scale = wp.vec3(m[0], m[1], m[2])
                albedo = m[3] * wp.cw_mul(lobe.scale, fresnel_schlick(weight, edge, cos_o))
        if wp.static(has_dielectric):
            if kind == _DIELECTRIC:
                coat = coat_reflects(closures, c, tables, cos_o)
                lobe.scale = coat[1] * weight
                albedo = coat[0] * weight
        if wp.static(has_glass):
            if kind == _GLASS:
                roughness = closures[c].roughness
                eta = relative_index(closures[c].ior, frame.entering)
                lobe.scale = weight
                # where refraction is not blurred, facets do not hide light from each other either
                if closures[c].colour_scale > 0.0 and not is_refraction_specular(roughness * roughness, eta):
                    lobe.scale = weight / glass_albedo(tables, roughness, eta, cos_o)
                albedo = weight
        if wp.static(has_transparent):
            if kind == _TRANSPARENT:
                lobe.scale = weight
                albedo = weight
        lobe.selection = _sum(albedo)
        return lobe

    @wp.func
    def mirror_fresnel(closures: wp.array(dtype=ClosureRecord), c: int, cosine: float) -> wp.vec3:
        """Reflectance of a facet of a GLOSSY, METAL or DIELECTRIC closure."""
        kind = closures[c].kind
        f = wp.vec3(1.0)
        if wp.static(has_metal):
            if kind == _METAL:
                f = fresnel_schlick(closures[c].weight, closures[c].edge, cosine)
        if wp.static(has_dielectric):
            if kind == _DIELECTRIC:
                f = wp.vec3(fresnel_dielectric(cosine, closures[c].ior))
        return f

    return LobeFunctions(view_lobe, mirror_fresnel)
