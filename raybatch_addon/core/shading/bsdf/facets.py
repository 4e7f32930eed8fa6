"""Rough surfaces of microfacets: how many facets a direction sees, how they shadow each other, and their sampling.

GGX, isotropic and anisotropic, and Beckmann, each compiled where `ClosureFeatures` has it. Directions point away from
the surface.
"""

import functools
from typing import NamedTuple

import warp as wp

from ...scene.description import ClosureKind
from ..sampling import bitangent_of, tangent_of, to_world
from .beckmann import beckmann_distribution, beckmann_projected, sample_visible_slope
from .ggx import (
    ALPHA_MIN,
    ggx_distribution,
    ggx_shadowing,
    ggx_stretched_distribution,
    ggx_visible,
    is_specular,
    sample_visible_normal,
)
from .materials import ClosureFeatures, ClosureRecord

_K = ClosureKind


@wp.struct
class Facets:
    """The facets of a closure as they are seen from wo."""

    normal: wp.vec3  # macroscopic, on the side of wo
    tangent: wp.vec3  # unit; `alpha_x` is along it, `alpha_y` along `bitangent`; not set where facets are isotropic
    bitangent: wp.vec3
    cos_o: float  # cosine of wo to `normal`, > 0
    alpha: float  # alpha of isotropic facets with as wide a spread of slopes: the geometric mean of the two below
    alpha_x: float
    alpha_y: float
    beckmann: int


class FacetFunctions(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    alpha: wp.Function  # (closures, c: int) -> float: mean alpha
    of: wp.Function  # (closures, c: int, normal: vec3, cos_o: float) -> Facets
    # (facets, wo, half: vec3) -> float: density of visible normals over (wo . h), for `half` of any length
    visible_density: wp.Function
    shadowing: wp.Function  # (facets, wo, wi, cos_i: float) -> float: G2(wo, wi) / G1(wo), cosines > 0
    sample: wp.Function  # (facets, wo, u: vec2) -> vec3: a visible normal


@functools.cache
def make_facets(features: ClosureFeatures) -> FacetFunctions:
    """The functions for closures of `features`."""
    anisotropic, beckmann = features.has(_K.ANISOTROPIC), features.has(_K.BECKMANN)

    @wp.func
    def alphas(closures: wp.array(dtype=ClosureRecord), c: int) -> wp.vec2:
        """Alpha along the tangent and across it, each at most 1.

        Both are at least `ALPHA_MIN` where one of them is above it.
        """
        alpha = closures[c].roughness * closures[c].roughness
        along = alpha
        across = alpha
        aspect = closures[c].aspect
        tangent = closures[c].tangent
        if aspect > 0.0 and aspect != 1.0 and wp.dot(tangent, tangent) > 0.0:
            along = wp.min(alpha * aspect, 1.0)
            across = wp.min(alpha / aspect, 1.0)
            if not is_specular(wp.max(along, across)):
                along = wp.max(along, wp.static(ALPHA_MIN))
                across = wp.max(across, wp.static(ALPHA_MIN))
        return wp.vec2(along, across)

    @wp.func
    def mean_alpha(closures: wp.array(dtype=ClosureRecord), c: int) -> float:
        """Alpha of isotropic facets with as wide a spread of slopes: the geometric mean of both alphas."""
        alpha = closures[c].roughness * closures[c].roughness
        if wp.static(anisotropic):
            two = alphas(closures, c)
            if two[0] != two[1]:
                alpha = wp.sqrt(two[0]) * wp.sqrt(two[1])
                if not is_specular(wp.max(two[0], two[1])):
                    alpha = wp.max(alpha, wp.static(ALPHA_MIN))
        return alpha

    @wp.func
    def facets_of(closures: wp.array(dtype=ClosureRecord), c: int, normal: wp.vec3, cos_o: float) -> Facets:
        """Facets of closure `c` about `normal`."""
        facets = Facets()
        facets.normal = normal
        facets.cos_o = cos_o
        facets.alpha = mean_alpha(closures, c)
        facets.alpha_x = facets.alpha
        facets.alpha_y = facets.alpha
        if wp.static(anisotropic):
            two = alphas(closures, c)
            across = wp.cross(normal, closures[c].tangent)
            length = wp.length(across)
            # isotropic where the tangent is along the normal, or none
            if two[0] != two[1] and length > 0.0:
                facets.alpha_x = two[0]
                facets.alpha_y = two[1]
                facets.bitangent = across / length
                facets.tangent = wp.cross(facets.bitangent, normal)
        if wp.static(beckmann):
            facets.beckmann = closures[c].distribution
        return facets

    @wp.func
    def spread(facets: Facets, w: wp.vec3, cosine: float) -> float:
        """Alpha times the sine of unit `w` to the normal: sqrt(alpha_x^2 x^2 + alpha_y^2 y^2)."""
        if facets.alpha_x == facets.alpha_y:
            return facets.alpha_x * wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0))
        x = facets.alpha_x * wp.dot(w, facets.tangent)
        y = facets.alpha_y * wp.dot(w, facets.bitangent)
        return wp.sqrt(x * x + y * y)

    @wp.func
    def projected(facets: Facets, w: wp.vec3, cosine: float) -> float:
        """Area of the facets seen from `w`, over that of the surface: cos (1 + Lambda)."""
        s = spread(facets, w, cosine)
        area = 0.5 * (cosine + wp.sqrt(cosine * cosine + s * s))
        if wp.static(beckmann):
            if facets.beckmann == 1:
                area = beckmann_projected(cosine, s)
        return area

    @wp.func
    def visible_density(facets: Facets, wo: wp.vec3, half: wp.vec3) -> float:
        """Density of visible normals over (wo . h) [1/sr], for `half` of any length."""
        if wp.static(anisotropic or beckmann):
            if facets.alpha_x != facets.alpha_y or facets.beckmann == 1:
                local = half
                if facets.alpha_x != facets.alpha_y:
                    local = wp.vec3(
                        wp.dot(half, facets.tangent), wp.dot(half, facets.bitangent), wp.dot(half, facets.normal)
                    )
                else:
                    # the length from the cross product keeps its digits near the normal
                    across = wp.cross(facets.normal, half)
                    local = wp.vec3(wp.length(across), 0.0, wp.dot(half, facets.normal))
                d = float(0.0)
                if wp.static(beckmann):
                    if facets.beckmann == 1:
                        d = beckmann_distribution(facets.alpha_x, facets.alpha_y, local)
                if wp.static(anisotropic):
                    if facets.beckmann != 1:
                        d = ggx_stretched_distribution(facets.alpha_x, facets.alpha_y, local)
                return d / projected(facets, wo, facets.cos_o)
        sine = wp.cross(facets.normal, half)  # the cross product keeps its digits near the normal
        alpha = facets.alpha
        return ggx_distribution(alpha, wp.min(wp.dot(sine, sine) / wp.dot(half, half), 1.0)) * ggx_visible(
            alpha, facets.cos_o
        )

    @wp.func
    def shadowing(facets: Facets, wo: wp.vec3, wi: wp.vec3, cos_i: float) -> float:
        """G2(wo, wi) / G1(wo) in [0, 1]: the share that remains of a visible-normal sample.

        `cos_i` > 0 is |wi . normal|.
        """
        if wp.static(anisotropic or beckmann):
            if facets.alpha_x != facets.alpha_y or facets.beckmann == 1:
                seen_o = projected(facets, wo, facets.cos_o)
                seen_i = projected(facets, wi, cos_i)
                return seen_o * cos_i / (seen_o * cos_i + (seen_i - cos_i) * facets.cos_o)
        return ggx_shadowing(facets.alpha, facets.cos_o, cos_i)

    @wp.func
    def sample_normal(facets: Facets, wo: wp.vec3, u: wp.vec2) -> wp.vec3:
        """A facet's normal with the density `visible_density` (wo . h)."""
        t = tangent_of(facets.normal)
        b = bitangent_of(facets.normal)
        if wp.static(anisotropic):
            if facets.alpha_x != facets.alpha_y:
                t = facets.tangent
                b = facets.bitangent
        local = wp.vec3(wp.dot(wo, t), wp.dot(wo, b), facets.cos_o)
        if wp.static(beckmann):
            if facets.beckmann == 1:
                return to_world(sample_visible_slope(local, facets.alpha_x, facets.alpha_y, u), t, b, facets.normal)
        return to_world(sample_visible_normal(local, facets.alpha_x, facets.alpha_y, u), t, b, facets.normal)

    return FacetFunctions(mean_alpha, facets_of, visible_density, shadowing, sample_normal)
