"""Colours of a material by component: the light that its closures would scatter in a white world, approximate."""

import functools

import warp as wp

from ...scene.description import ClosureKind
from ...shading.bsdf.albedo import AlbedoTables
from ...shading.bsdf.ggx import ggx_slope
from ...shading.bsdf.lobes import Lobe, make_lobes
from ...shading.bsdf.materials import DIFFUSE_KINDS, REFLECTION_KINDS, ClosureFeatures, ClosureRecord, ShadingFrame

_K = ClosureKind
_GLASS = wp.constant(int(_K.GLASS))
_SHEET = wp.constant(int(_K.SHEET))
_REFRACTION = wp.constant(int(_K.REFRACTION))
_PHONG = wp.constant(int(_K.ASHIKHMIN_SHIRLEY))
# Light below a surface comes out of it by Lambert's law
_DIFFUSE_KINDS = (*DIFFUSE_KINDS, _K.SUBSURFACE)


@wp.struct
class ClosuresInView:
    """The closures of a surface, as a path sees them."""

    closures: wp.array(dtype=ClosureRecord)  # those from `first` on before `end` are the surface's
    first: int
    end: int
    lobes: wp.array(dtype=Lobe)  # of the same from 0 on, as `Bsdf.look` sees them from wo
    frame: ShadingFrame


@wp.struct
class ClosureColors:
    """Sums over the closures of a material, by component."""

    diffuse: wp.vec3
    glossy: wp.vec3
    transmission: wp.vec3


@wp.func
def facet_cosine(roughness: float, cosine: float) -> float:
    """Cosine between a direction and the facets that it sees, about their mean (`shading/bsdf/albedo.py`)."""
    return ggx_slope(roughness * roughness, cosine)


@functools.cache
def make_closure_colors(features: ClosureFeatures) -> wp.Function:
    """Function (view: ClosuresInView, albedo: AlbedoTables) -> ClosureColors."""
    functions = make_lobes(features)
    reflectance, mirror = functions.reflectance, functions.mirror
    is_diffuse, is_mirror = features.test(_DIFFUSE_KINDS), features.test(REFLECTION_KINDS)
    has_mirror, has_glass = features.has(*REFLECTION_KINDS), features.has(_K.GLASS)
    has_opaque, is_opaque = features.has(_K.METAL, _K.CONDUCTOR), features.test((_K.METAL, _K.CONDUCTOR))
    has_refraction, has_phong = features.has(_K.REFRACTION), features.has(_K.ASHIKHMIN_SHIRLEY)

    @wp.func
    def closure_colors(view: ClosuresInView, albedo: AlbedoTables) -> ClosureColors:
        colors = ClosureColors()
        for c in range(view.first, view.end):
            kind = view.closures[c].kind
            lobe = view.lobes[c - view.first]
            if is_diffuse(kind):
                colors.diffuse += lobe.scale
            if wp.static(has_mirror):
                if is_mirror(kind) and lobe.selection > 0.0:
                    facets = mirror(view.closures, c, albedo, view.frame.entering, lobe.cosine)
                    seen = facets.seen
                    if wp.static(has_opaque):
                        if is_opaque(kind):  # of a facet as they are turned on average
                            cosine = facet_cosine(view.closures[c].roughness, lobe.cosine)
                            seen = reflectance(view.closures, c, albedo, cosine, view.frame.entering)
                    color = wp.cw_mul(lobe.scale, seen)
                    if view.closures[c].multiscatter == 1:
                        color = facets.single * color
                    if kind == _SHEET:
                        colors.transmission += color
                    else:
                        colors.glossy += color
            if wp.static(has_phong):
                if kind == _PHONG:
                    colors.glossy += lobe.scale
            if wp.static(has_refraction):
                if kind == _REFRACTION:
                    colors.transmission += lobe.scale
            if wp.static(has_glass):
                if kind == _GLASS and lobe.selection > 0.0:
                    cosine = facet_cosine(view.closures[c].roughness, lobe.cosine)
                    f = reflectance(view.closures, c, albedo, cosine, view.frame.entering)
                    colors.glossy += wp.cw_mul(lobe.scale, f)
                    colors.transmission += wp.cw_mul(
                        lobe.scale, wp.cw_mul(wp.vec3(1.0) - f, view.closures[c].refraction)
                    )
        return colors

    return closure_colors
