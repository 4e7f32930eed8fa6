"""Evaluation and sampling of materials, compiled for the closure kinds of a scene alone.

wo and wi are unit and point away from the surface. Lambertian closures use the shading normal, and
those of facets a normal that is bent, where an interpolated one would mirror wo into the surface.
Light does not leak: reflected directions are on the geometric normal's side, refracted ones on the
other, and everything else is 0.
"""

import functools
from typing import NamedTuple

import warp as wp

from ..scene.description import ClosureKind
from .albedo import AlbedoTables
from .lobes import Lobe, make_lobes, relative_index
from .materials import (
    DELTA, DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT,
    BsdfSample, BsdfValue, ClosureFeatures, ClosureRecord, MaterialTable, ShadingFrame, upload_materials,
)  # fmt: skip
from .microfacet import (
    fresnel_dielectric, ggx_distribution, ggx_shadowing, ggx_visible,
    is_refraction_specular, is_specular, reflected, refracted, sample_visible_normal,
)  # fmt: skip
from .sampling import bitangent_of, sample_cosine_hemisphere, tangent_of, to_world

__all__ = [
    "DELTA", "DIFFUSE", "GLOSSY", "TRANSMISSION", "TRANSPARENT",
    "Bsdf", "BsdfSample", "BsdfValue", "ClosureFeatures", "ClosureRecord", "MaterialTable", "ShadingFrame",
    "make_bsdf", "upload_materials",
]  # fmt: skip

_K = ClosureKind
_DIFFUSE = wp.constant(int(_K.DIFFUSE))
_LAYERED_DIFFUSE = wp.constant(int(_K.LAYERED_DIFFUSE))
_GLOSSY = wp.constant(int(_K.GLOSSY))
_METAL = wp.constant(int(_K.METAL))
_DIELECTRIC = wp.constant(int(_K.DIELECTRIC))
_GLASS = wp.constant(int(_K.GLASS))
_TRANSPARENT = wp.constant(int(_K.TRANSPARENT))
_EMISSION = wp.constant(int(_K.EMISSION))
_ONE_BELOW = wp.constant(1.0 - 2.0**-24)  # the largest float32 below 1

# Share of wo's height above the triangle that a mirrored direction keeps at least, by bending the
# normal. A choice of look, as any treatment of interpolated normals; flat surfaces have the share 1.
_HEIGHT_KEPT = wp.constant(0.25)


class Bsdf(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    evaluate: wp.Function  # (closures, first, end, albedo, frame, wo, wi) -> BsdfValue
    sample: wp.Function  # (closures, first, end, albedo, frame, wo, u_lobe: float, u: vec2) -> BsdfSample
    emission: wp.Function  # (closures, first, end) -> vec3: radiance [W/(m² sr)], the same on both sides
    transparency: wp.Function  # (closures, first, end) -> vec3: share of light that passes straight on
    scatters: wp.Function  # (closures, first, end) -> bool: has lobes for `evaluate`; if not, shadow rays are in vain


@wp.struct
class _Mixture:
    """Sums over a material's closures for one pair of directions. pdf = (Lambertian + others) / selection."""

    diffuse: wp.vec3  # of Lambertian closures: f |cos| but for the factor cos / pi
    diffuse_selection: float
    lambert: float  # that factor, which is their density too
    value: wp.vec3  # of other closures: f |cos|
    density: float  # of other closures: selection * density
    selection: float  # of all closures


@wp.func
def _facet_normal(frame: ShadingFrame, wo: wp.vec3) -> wp.vec3:
    """The shading normal, bent so that wo is above it and wo's mirror direction above the triangle.

    After Keller et al., "The Iray Light Transport Simulation and Rendering System" (2017), A.3.
    """
    n = frame.normal
    c = wp.dot(n, wo)
    # a normal that faces away from wo is first turned to be perpendicular to it
    mirrored = 2.0 * wp.max(c, 0.0) * n - wo
    height = wp.dot(mirrored, frame.geometric_normal)
    least = _HEIGHT_KEPT * wp.dot(wo, frame.geometric_normal)
    if c > 0.0 and height >= least:
        return n
    return wp.normalize(wo + wp.normalize(mirrored + (least - height) * frame.geometric_normal))


@wp.func
def _visible_density(alpha: float, cos_o: float, n: wp.vec3, half: wp.vec3) -> float:
    """Density of visible normals over (wo . h), for `half` of any length; its sine by the precise cross product."""
    sine = wp.cross(n, half)
    return ggx_distribution(alpha, wp.min(wp.dot(sine, sine) / wp.dot(half, half), 1.0)) * ggx_visible(alpha, cos_o)


@functools.cache
def make_bsdf(features: ClosureFeatures) -> Bsdf:
    """The functions for materials of `features.kinds`; nothing of other kinds is compiled."""
    has = features.has
    view, mirror_fresnel = make_lobes(features)
    has_mirror = has(_K.GLOSSY, _K.METAL, _K.DIELECTRIC)
    has_glass, has_transparent, has_emission = has(_K.GLASS), has(_K.TRANSPARENT), has(_K.EMISSION)
    has_facets, has_coats = features.facets, features.coats
    has_lambert = has(_K.DIFFUSE, _K.LAYERED_DIFFUSE)

    @wp.func
    def mix(
        closures: wp.array(dtype=ClosureRecord), first: int, end: int, albedo: AlbedoTables, frame: ShadingFrame, wo: wp.vec3, wi: wp.vec3
    ) -> _Mixture:
        """All closures but their delta lobes; the selection counts delta lobes too."""
        mixture = _Mixture()
        above = wp.dot(wi, frame.geometric_normal)
        mixture.lambert = wp.max(wp.dot(wi, frame.normal), 0.0) / wp.PI
        if above <= 0.0:
            mixture.lambert = 0.0
        n = frame.normal
        cos_o = float(1.0)
        if wp.static(has_facets or has_coats):
            n = _facet_normal(frame, wo)
            cos_o = wp.dot(n, wo)
            if not cos_o > 0.0:  # wo lies in the triangle's plane
                return _Mixture()
        for c in range(first, end):
            kind = closures[c].kind
            lobe = view(closures, c, albedo, frame, cos_o)
            mixture.selection += lobe.selection
            if wp.static(has_lambert):
                if kind == _DIFFUSE or kind == _LAYERED_DIFFUSE:
                    mixture.diffuse += lobe.scale
                    mixture.diffuse_selection += lobe.selection
            if wp.static(has_facets):
                cos_i = wp.dot(n, wi)
                alpha = closures[c].roughness * closures[c].roughness
                if cos_i > 0.0 and above > 0.0 and not is_specular(alpha):
                    half = wo + wi
                    cosine = wp.min(wp.length(half) * 0.5, 1.0)  # to either direction
                    pdf = 0.25 * _visible_density(alpha, cos_o, n, half)
                    shadowed = pdf * ggx_shadowing(alpha, cos_o, cos_i)
                    if wp.static(has_mirror):
                        if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC:
                            mixture.value += shadowed * wp.cw_mul(lobe.scale, mirror_fresnel(closures, c, cosine))
                            mixture.density += lobe.selection * pdf
                    if wp.static(has_glass):
                        if kind == _GLASS:
                            f = fresnel_dielectric(cosine, relative_index(closures[c].ior, frame.entering))
                            mixture.value += (f * shadowed) * lobe.scale
                            mixture.density += lobe.selection * (f * pdf)
                if wp.static(has_glass):
                    if kind == _GLASS and cos_i < 0.0 and above < 0.0 and not is_specular(alpha):
                        eta = relative_index(closures[c].ior, frame.entering)
                        half = wo + eta * wi
                        if wp.dot(half, n) < 0.0:
                            half = -half
                        c_o = wp.dot(wo, half)
                        c_i = wp.dot(wi, half)
                        if c_o > 0.0 and c_i < 0.0 and not is_refraction_specular(alpha, eta):
                            square = wp.dot(half, half)
                            root = wp.sqrt(square)
                            passed = 1.0 - fresnel_dielectric(c_o / root, eta)
                            # Walter et al. 2007, equation 17: its denominator is the half vector's squared length
                            jacobian = (eta * (c_o / root)) * (eta * (-c_i / root)) / square
                            pdf = passed * _visible_density(alpha, cos_o, n, half) * jacobian
                            shadowed = pdf * ggx_shadowing(alpha, cos_o, -cos_i)
                            mixture.value += shadowed * wp.cw_mul(lobe.scale, closures[c].refraction)
                            mixture.density += lobe.selection * pdf
        return mixture

    @wp.func
    def evaluate(
        closures: wp.array(dtype=ClosureRecord), first: int, end: int, albedo: AlbedoTables, frame: ShadingFrame, wo: wp.vec3, wi: wp.vec3
    ) -> BsdfValue:
        """Value and density of all lobes but delta ones; 0 where there is nothing."""
        result = BsdfValue()
        mixture = mix(closures, first, end, albedo, frame, wo, wi)
        if mixture.selection > 0.0:
            result.value = mixture.value
            result.pdf = mixture.density
            if wp.static(has_lambert):
                result.diffuse = mixture.lambert * mixture.diffuse
                result.value += result.diffuse
                result.pdf += mixture.lambert * mixture.diffuse_selection
            result.pdf = result.pdf / mixture.selection
        return result

    @wp.func
    def sample(
        closures: wp.array(dtype=ClosureRecord), first: int, end: int, albedo: AlbedoTables, frame: ShadingFrame, wo: wp.vec3,
        u_lobe: float, u: wp.vec2,
    ) -> BsdfSample:  # fmt: skip
        """A direction by one closure, chosen by what it reflects, weighted as a sample of all together."""
        result = BsdfSample()
        n = frame.normal
        cos_o = float(1.0)
        if wp.static(has_facets or has_coats):
            n = _facet_normal(frame, wo)
            cos_o = wp.dot(n, wo)
            if not cos_o > 0.0:
                return result

        # one pass over the closures; u_lobe is stretched after each decision, and so serves them all
        total = float(0.0)
        chosen = int(-1)
        left = float(u_lobe)
        lobe = Lobe()
        for c in range(first, end):
            candidate = view(closures, c, albedo, frame, cos_o)
            if candidate.selection > 0.0:
                total += candidate.selection
                p = candidate.selection / total
                if left < p:
                    left = wp.min(left / p, _ONE_BELOW)
                    chosen = int(c)
                    lobe = candidate
                else:
                    left = wp.min((left - p) / (1.0 - p), _ONE_BELOW)
        if chosen < 0:
            return result

        kind = closures[chosen].kind
        wi = -wo
        bits = int(0)
        delta = wp.vec3(0.0)  # times the probability of the lobe: weight of a delta lobe
        if wp.static(has_lambert):
            if kind == _DIFFUSE or kind == _LAYERED_DIFFUSE:
                wi = to_world(sample_cosine_hemisphere(u), frame.tangent, frame.bitangent, frame.normal)
                bits = DIFFUSE
        if wp.static(has_transparent):
            if kind == _TRANSPARENT:
                bits = TRANSPARENT | DELTA
                delta = lobe.scale
        if wp.static(has_facets):
            if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC or kind == _GLASS:
                alpha = closures[chosen].roughness * closures[chosen].roughness
                h = n
                if not is_specular(alpha):
                    t = tangent_of(n)
                    b = bitangent_of(n)
                    facet = sample_visible_normal(wp.vec3(wp.dot(wo, t), wp.dot(wo, b), cos_o), alpha, u)
                    h = to_world(facet, t, b, n)
                cosine = wp.max(wp.dot(wo, h), 0.0)
                bits = GLOSSY
                passes = bool(False)
                if wp.static(has_glass):
                    if kind == _GLASS:
                        eta = relative_index(closures[chosen].ior, frame.entering)
                        if left >= fresnel_dielectric(cosine, eta):
                            passes = True
                            bits = TRANSMISSION
                            if is_refraction_specular(alpha, eta):
                                h = n
                                bits = TRANSMISSION | DELTA
                            wi = refracted(wo, h, eta)
                            if wp.dot(wi, wi) == 0.0:
                                # the facet lets it through where the surface as a whole would not: so nearly equal are the
                                # indices that it is hardly bent
                                wi = -wo
                if not passes:
                    wi = wp.normalize(reflected(wo, h))
                    if is_specular(alpha):
                        bits = GLOSSY | DELTA
                if (bits & DELTA) != 0:
                    delta = lobe.scale  # GLASS: Fresnel's factor is in the probability
                    if wp.static(has_glass):
                        if passes:
                            delta = wp.cw_mul(delta, closures[chosen].refraction)
                    if wp.static(has_mirror):
                        if kind != _GLASS:
                            delta = wp.cw_mul(lobe.scale, mirror_fresnel(closures, chosen, cosine))

        # A direction on a side that its lobe does not serve is absorbed: `mix` gives it no density there,
        # and another lobe's value must not be counted for it.
        side = wp.dot(wi, frame.geometric_normal)
        facet_side = side
        if wp.static(has_facets):
            if (bits & (GLOSSY | TRANSMISSION)) != 0:
                facet_side = wp.dot(wi, n)
        if (bits & (TRANSMISSION | TRANSPARENT)) != 0:
            side = -side
            facet_side = -facet_side
        if not (side > 0.0 and facet_side > 0.0):
            return result

        if (bits & DELTA) != 0:
            result.direction = wi
            result.lobe = bits
            result.weight = (total / lobe.selection) * delta
            return result

        mixture = mix(closures, first, end, albedo, frame, wo, wi)
        density = mixture.density
        if density > 0.0:
            value = mixture.value
            if wp.static(has_lambert):
                value += mixture.lambert * mixture.diffuse
                density += mixture.lambert * mixture.diffuse_selection
            result.weight = (mixture.selection / density) * value
            result.pdf = density / mixture.selection
        else:
            if wp.static(has_lambert):
                # without the cosine, which cancels: a lone Lambertian closure gives its weight to the bit
                if mixture.lambert > 0.0 and mixture.diffuse_selection > 0.0:
                    result.weight = (mixture.selection / mixture.diffuse_selection) * mixture.diffuse
                    result.pdf = mixture.lambert * mixture.diffuse_selection / mixture.selection
        if result.pdf > 0.0:
            result.direction = wi
            result.lobe = bits
        return result

    @wp.func
    def emission(closures: wp.array(dtype=ClosureRecord), first: int, end: int) -> wp.vec3:
        """Radiance that the surface emits, on both sides [W/(m² sr)]."""
        radiance = wp.vec3(0.0)
        if wp.static(has_emission):
            for c in range(first, end):
                if closures[c].kind == _EMISSION:
                    radiance += closures[c].weight
        return radiance

    @wp.func
    def transparency(closures: wp.array(dtype=ClosureRecord), first: int, end: int) -> wp.vec3:
        """Share of light that passes straight through the surface."""
        passed = wp.vec3(0.0)
        if wp.static(has_transparent):
            for c in range(first, end):
                if closures[c].kind == _TRANSPARENT:
                    passed += closures[c].weight
        return passed

    @wp.func
    def scatters(closures: wp.array(dtype=ClosureRecord), first: int, end: int) -> bool:
        """Whether any closure has a lobe that `evaluate` sees."""
        found = bool(False)
        for c in range(first, end):
            kind = closures[c].kind
            if wp.static(has_lambert):
                if kind == _DIFFUSE or kind == _LAYERED_DIFFUSE:
                    found = True
            if wp.static(has_facets):
                if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC or kind == _GLASS:
                    if not is_specular(closures[c].roughness * closures[c].roughness):
                        found = True
        return found

    return Bsdf(evaluate, sample, emission, transparency, scatters)
