"""Evaluation and sampling of materials, compiled for the closure kinds of a scene alone.

A material is a range [first, end) of an array of `ClosureRecord`s: a part of its table, or what a shader program made. wo and wi
are unit and point away from the surface.
"""

import functools
from typing import NamedTuple

import warp as wp

from ..scene.description import ClosureKind
from .albedo import AlbedoTables
from .facets import make_facets
from .lobes import Lobe, make_lobes, relative_index
from .materials import (
    DELTA, DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT,
    BsdfSample, BsdfValue, ClosureFeatures, ClosureRecord, MaterialTable, ShadingFrame, upload_materials,
)  # fmt: skip
from .microfacet import is_refraction_specular, is_specular, reflected, refracted
from .mixture import facet_normal, make_mixture, make_normals
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


class Bsdf(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    evaluate: wp.Function  # (closures, first, end, albedo, frame, wo, wi) -> BsdfValue
    sample: wp.Function  # (closures, first, end, albedo, frame, wo, u_lobe: float, u: vec2) -> BsdfSample
    emission: wp.Function  # (closures, first, end) -> vec3: radiance [W/(m² sr)], the same on both sides
    transparency: wp.Function  # (closures, first, end) -> vec3: share of light that passes straight on
    scatters: wp.Function  # (closures, first, end) -> bool: has lobes for `evaluate`; if not, shadow rays are in vain


@functools.cache
def make_bsdf(features: ClosureFeatures) -> Bsdf:
    """The functions for materials of `features.kinds`; nothing of other kinds is compiled."""
    has = features.has
    view, reflectance = make_lobes(features)
    mean_alpha, facets_of, _, _, sample_normal = make_facets(features)
    mix, glass_reflects = make_mixture(features)
    has_glass, has_transparent, has_emission = has(_K.GLASS), has(_K.TRANSPARENT), has(_K.EMISSION)
    has_facets, has_coats = features.facets, features.coats
    has_lambert = has(_K.DIFFUSE, _K.LAYERED_DIFFUSE)
    bends = has_facets or has_coats
    own = features.own_normals
    has_own_normal, own_normal = make_normals(own)

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
                result.diffuse += mixture.soft
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
        if wp.static(bends and not own):
            n = facet_normal(frame.normal, frame, wo)
            cos_o = wp.dot(n, wo)
            if not cos_o > 0.0:
                return result

        # one pass over the closures; u_lobe is stretched after each decision, and so serves them all
        total = float(0.0)
        chosen = int(-1)
        left = float(u_lobe)
        lobe = Lobe()
        for c in range(first, end):
            if wp.static(bends and own):
                cos_o = wp.dot(facet_normal(own_normal(closures, c, frame), frame, wo), wo)
                if not cos_o > 0.0:
                    return result
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
        about = frame.normal
        tangent = frame.tangent
        bitangent = frame.bitangent
        if wp.static(own):
            if has_own_normal(closures, chosen):
                about = own_normal(closures, chosen, frame)
                tangent = tangent_of(about)
                bitangent = bitangent_of(about)
            if wp.static(bends):
                n = facet_normal(about, frame, wo)
                cos_o = wp.dot(n, wo)
        if wp.static(has_lambert):
            if kind == _DIFFUSE or kind == _LAYERED_DIFFUSE:
                wi = to_world(sample_cosine_hemisphere(u), tangent, bitangent, about)
                bits = DIFFUSE
        if wp.static(has_transparent):
            if kind == _TRANSPARENT:
                bits = TRANSPARENT | DELTA
                delta = lobe.scale
        if wp.static(has_facets):
            if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC or kind == _GLASS:
                alpha = mean_alpha(closures, chosen)
                h = n
                if not is_specular(alpha):
                    h = sample_normal(facets_of(closures, chosen, n, cos_o), wo, u)
                cosine = wp.max(wp.dot(wo, h), 0.0)
                f = reflectance(closures, chosen, cosine, frame.entering)
                bits = GLOSSY
                share = float(1.0)  # of the samples, those that go this way
                if wp.static(has_glass):
                    if kind == _GLASS:
                        eta = relative_index(closures[chosen].ior, frame.entering)
                        share = glass_reflects(closures, chosen, f)
                        if left >= share:
                            bits = TRANSMISSION
                            share = 1.0 - share
                            f = wp.cw_mul(wp.vec3(1.0) - f, closures[chosen].refraction)
                            if is_refraction_specular(alpha, eta):
                                h = n
                                bits = TRANSMISSION | DELTA
                            wi = refracted(wo, h, eta)
                            if wp.dot(wi, wi) == 0.0:
                                # the facet lets it through where the surface as a whole would not: so nearly equal are the
                                # indices that it is hardly bent
                                wi = -wo
                if (bits & GLOSSY) != 0:
                    wi = wp.normalize(reflected(wo, h))
                    if is_specular(alpha):
                        bits = GLOSSY | DELTA
                if (bits & DELTA) != 0:
                    delta = wp.cw_mul(lobe.scale, f / share)

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
                    if not is_specular(mean_alpha(closures, c)):
                        found = True
        return found

    return Bsdf(evaluate, sample, emission, transparency, scatters)
