"""Sums over all closures of a material for a pair of directions, and the normals that the closures are about.

wo and wi are unit and point away from the surface. Diffuse closures use the shading normal. Facets use a bent normal
where the interpolated one would mirror wo into the surface. Light does not leak: reflected directions are on the
geometric normal's side, refracted ones on the other, and everything else is 0.
"""

import functools
import math
from typing import NamedTuple

import warp as wp

from ...scene.description import ClosureKind
from ..sampling import tangent_of
from .albedo import AlbedoTables
from .ashikhmin_shirley import phong_density, phong_exponent
from .diffuse import rough_diffuse_bsdf
from .drawn.toon import toon_bsdf
from .facets import make_facets
from .ggx import is_refraction_specular, is_specular
from .lobes import Lobe, make_lobes, relative_index
from .materials import (
    MICROFACET_KINDS,
    MIRROR_KINDS,
    NO_REFLECTION,
    PASSING_KINDS,
    ClosureFeatures,
    ClosureRecord,
    ShadingFrame,
)
from .normals import bump_shadow, make_normals
from .sheen import sheen_density, sheen_lobe, sheen_tangent, velvet_bsdf

_K = ClosureKind
_GLASS = wp.constant(int(_K.GLASS))
_ROUGH_DIFFUSE = wp.constant(int(_K.ROUGH_DIFFUSE))
_TRANSLUCENT = wp.constant(int(_K.TRANSLUCENT))
_ASHIKHMIN_SHIRLEY = wp.constant(int(_K.ASHIKHMIN_SHIRLEY))
_SHEEN = wp.constant(int(_K.SHEEN))
_VELVET = wp.constant(int(_K.VELVET))
_SHEET = wp.constant(int(_K.SHEET))
LAMBERTIAN = (_K.DIFFUSE, _K.LAYERED_DIFFUSE)
_TOON = wp.constant(int(_K.TOON))
SOFT = (_K.ROUGH_DIFFUSE, _K.TRANSLUCENT, _K.SHEEN, _K.VELVET, _K.TOON)  # other closures without facets


class MixtureFunctions(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    mix: wp.Function  # (closures, first, end, lobes, albedo, frame, wo, wi) -> Mixture
    # (closures, c: int, f: vec3) -> vec2: shares of samples that a facet of glass reflects and refracts
    glass_shares: wp.Function
    reflected: wp.Function  # (closures, c: int, f: vec3) -> vec3: what is reflected of the share f; less for half glass


@wp.struct
class Mixture:
    """Sums over a material's closures for one pair of directions. pdf = (Lambertian + others) / selection."""

    diffuse: wp.vec3  # Lambertian closures about the frame's normal: f |cos| without the factor cos / pi
    diffuse_selection: float
    lambert: float  # the factor cos / pi, which is also their density
    value: wp.vec3  # other closures: f |cos|
    soft: wp.vec3  # the part of `value` that is diffuse
    density: float  # other closures: selection * density
    selection: float  # all closures


@wp.func
def _mean(v: wp.vec3) -> float:
    """Mean of the channels; the mean of a grey is the grey, to the bit."""
    return v[0] + ((v[1] - v[0]) + (v[2] - v[0])) * wp.static(1.0 / 3.0)


@functools.cache
def make_mixture(features: ClosureFeatures) -> MixtureFunctions:
    """The functions for closures of `features`."""
    has = features.has
    reflectance = make_lobes(features).reflectance
    mean_alpha, facets_of, visible_density, shadowing, _ = make_facets(features)
    is_lambertian, is_soft = features.test(LAMBERTIAN), features.test(SOFT)
    is_mirror, is_passing = features.test(MIRROR_KINDS), features.test(PASSING_KINDS)
    has_lambert, has_soft = has(*LAMBERTIAN), has(*SOFT)
    has_glass, has_mirror, has_passing = has(_K.GLASS), has(*MIRROR_KINDS), has(*PASSING_KINDS)
    has_rough_diffuse, has_translucent, has_sheen, has_velvet, has_toon = (has(kind) for kind in SOFT)
    has_phong, has_sheet, has_facets = has(_K.ASHIKHMIN_SHIRLEY), has(_K.SHEET), features.facets
    is_facets = features.test(MICROFACET_KINDS)
    bends = features.facets or features.coats
    own = features.own_normals
    has_own_normal, own_normal = make_normals(own)

    @wp.func
    def soft(
        closures: wp.array(dtype=ClosureRecord),
        c: int,
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        wi: wp.vec3,
    ) -> wp.vec4:
        """(f |cos| over the closure's scale, density) of one of `SOFT`; wi is on its side of the triangle."""
        kind = closures[c].kind
        normal = own_normal(closures, c, frame)
        cosine = wp.dot(normal, wi)
        found = wp.vec4(0.0)
        if wp.static(has_rough_diffuse):
            if kind == _ROUGH_DIFFUSE:
                f = rough_diffuse_bsdf(closures[c].roughness, wp.min(closures[c].color, wp.vec3(1.0)), wo, wi, normal)
                found = wp.vec4(f[0], f[1], f[2], wp.max(cosine, 0.0) / wp.PI)
        if wp.static(has_translucent):
            if kind == _TRANSLUCENT:
                below = wp.max(-cosine, 0.0) / wp.PI
                found = wp.vec4(below, below, below, below)
        if wp.static(has_sheen):
            if kind == _SHEEN:
                lobe = sheen_lobe(albedo.sheen, closures[c].roughness, wp.dot(normal, wo))
                along = sheen_tangent(normal, wo, tangent_of(normal))
                density = sheen_density(lobe, wp.vec3(wp.dot(wi, along), wp.dot(wi, wp.cross(normal, along)), cosine))
                found = wp.vec4(density, density, density, density)
        if wp.static(has_velvet):
            if kind == _VELVET and cosine > 0.0:
                value = velvet_bsdf(closures[c].roughness, wo, wi, normal)
                found = wp.vec4(value, value, value, wp.static(0.5 / math.pi))
        if wp.static(has_toon):
            if kind == _TOON:
                drawn = toon_bsdf(
                    closures[c].distribution, closures[c].roughness, closures[c].mean_cosine, normal, wo, wi
                )
                found = wp.vec4(drawn[0], drawn[0], drawn[0], drawn[1])
                if closures[c].distribution == 1:
                    return found  # no diffuse light, which alone is shadowed by bumps
        if wp.static(own):
            if kind != _TRANSLUCENT and has_own_normal(closures, c):
                shadow = bump_shadow(normal, frame, wi)
                found = wp.vec4(shadow * found[0], shadow * found[1], shadow * found[2], found[3])
        return found

    @wp.func
    def phong(
        closures: wp.array(dtype=ClosureRecord), c: int, n: wp.vec3, cos_o: float, wo: wp.vec3, wi: wp.vec3
    ) -> wp.vec2:
        """(f cos over the closure's scale, density) of Ashikhmin and Shirley's lobe; wi is above the surface."""
        facets = facets_of(closures, c, n, cos_o)
        half = wp.normalize(wo + wi)
        along = tangent_of(n)
        if facets.alpha_x != facets.alpha_y:
            along = facets.tangent
        local = wp.vec3(wp.dot(half, along), wp.dot(half, wp.cross(n, along)), wp.dot(half, n))
        cos_i = wp.dot(n, wi)
        d = wp.max(wp.dot(half, wo), 1.0e-6)
        pdf = 0.25 * phong_density(phong_exponent(facets.alpha_x), phong_exponent(facets.alpha_y), local) / d
        return wp.vec2(pdf * cos_i / wp.max(cos_i, cos_o), pdf)

    @wp.func
    def reflected(closures: wp.array(dtype=ClosureRecord), c: int, f: wp.vec3) -> wp.vec3:
        """What of the share f of light, which a facet of glass reflects, goes on."""
        if closures[c].multiscatter == NO_REFLECTION:
            return wp.vec3(0.0)
        return f

    @wp.func
    def glass_shares(closures: wp.array(dtype=ClosureRecord), c: int, f: wp.vec3) -> wp.vec2:
        """Shares of the samples that a facet reflects and refracts, among those that it does not absorb.

        Where f is grey and nothing is absorbed the shares are f and 1 - f to the bit, as f + (1 - f) rounds to 1:
        samples then have the weight 1.
        """
        reflects = _mean(f)
        if wp.static(features.half_glass):
            reflects = _mean(reflected(closures, c, f))
        passes = _mean(wp.cw_mul(wp.vec3(1.0) - f, closures[c].refraction))
        total = reflects + passes
        if total > 0.0:
            return wp.vec2(reflects / total, passes / total)
        return wp.vec2(1.0, 0.0)

    @wp.func
    def mix(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        wi: wp.vec3,
    ) -> Mixture:
        """Sums over all closures without their delta lobes; the selection counts delta lobes too. `lobes` holds the
        closures as seen from wo.
        """
        mixture = Mixture()
        above = wp.dot(wi, frame.geometric_normal)
        mixture.lambert = wp.max(wp.dot(wi, frame.normal), 0.0) / wp.PI
        if above <= 0.0:
            mixture.lambert = 0.0
        for c in range(first, end):
            kind = closures[c].kind
            lobe = lobes[c - first]
            n = lobe.normal
            cos_o = lobe.cosine
            if wp.static(bends and not own):
                if not cos_o > 0.0:  # wo lies in the triangle's plane
                    return Mixture()
            mixture.selection += lobe.selection
            if wp.static(has_lambert):
                if is_lambertian(kind):
                    if has_own_normal(closures, c):
                        about = own_normal(closures, c, frame)
                        cosine = wp.dot(wi, about)
                        if above > 0.0 and cosine > 0.0:
                            value = (bump_shadow(about, frame, wi) * cosine / wp.PI) * lobe.scale
                            mixture.value += value
                            mixture.soft += value
                            mixture.density += lobe.selection * cosine / wp.PI
                    else:
                        mixture.diffuse += lobe.scale
                        mixture.diffuse_selection += lobe.selection
            if wp.static(has_soft):
                if is_soft(kind) and (above > 0.0) == (kind != _TRANSLUCENT):
                    both = soft(closures, c, albedo, frame, wo, wi)
                    value = wp.cw_mul(lobe.scale, wp.vec3(both[0], both[1], both[2]))
                    mixture.value += value
                    if wp.static(has_toon):
                        if kind != _TOON or closures[c].distribution == 0:
                            mixture.soft += value
                    else:
                        mixture.soft += value
                    mixture.density += lobe.selection * both[3]
            if wp.static(has_facets):
                cos_i = wp.dot(n, wi)
                alpha = mean_alpha(closures, c)
                if wp.static(own):
                    if is_facets(kind) and not cos_o > 0.0:
                        cos_i = 0.0  # turned away: no light on either side
                if cos_i > 0.0 and above > 0.0 and not is_specular(alpha):
                    if wp.static(has_mirror or has_glass):
                        if is_mirror(kind) or kind == _GLASS:
                            facets = facets_of(closures, c, n, cos_o)
                            half = wo + wi
                            cosine = wp.min(wp.length(half) * 0.5, 1.0)  # cosine of the half vector to either direction
                            pdf = 0.25 * visible_density(facets, wo, half)
                            shadowed = pdf * shadowing(facets, wo, wi, cos_i)
                            f = reflectance(closures, c, albedo, cosine, frame.entering)
                            if wp.static(has_glass):
                                if kind == _GLASS:
                                    pdf = glass_shares(closures, c, f)[0] * pdf
                                    if wp.static(features.half_glass):
                                        f = reflected(closures, c, f)
                            mixture.value += shadowed * wp.cw_mul(lobe.scale, f)
                            mixture.density += lobe.selection * pdf
                    if wp.static(has_phong):
                        if kind == _ASHIKHMIN_SHIRLEY:
                            bright = phong(closures, c, n, cos_o, wo, wi)
                            mixture.value += bright[0] * lobe.scale
                            mixture.density += lobe.selection * bright[1]
                if wp.static(has_sheet):
                    if kind == _SHEET and cos_i < 0.0 and above < 0.0 and not is_specular(alpha):
                        facets = facets_of(closures, c, n, cos_o)
                        behind = wi - (2.0 * cos_i) * n
                        pdf = 0.25 * visible_density(facets, wo, wo + behind)
                        mixture.value += (pdf * shadowing(facets, wo, behind, -cos_i)) * lobe.scale
                        mixture.density += lobe.selection * pdf
                if wp.static(has_passing):
                    if is_passing(kind) and cos_i < 0.0 and above < 0.0 and not is_specular(alpha):
                        eta = relative_index(closures[c].ior, frame.entering)
                        half = wo + eta * wi
                        if wp.dot(half, n) < 0.0:
                            half = -half
                        c_o = wp.dot(wo, half)
                        c_i = wp.dot(wi, half)
                        if c_o > 0.0 and c_i < 0.0 and not is_refraction_specular(alpha, eta):
                            facets = facets_of(closures, c, n, cos_o)
                            square = wp.dot(half, half)
                            root = wp.sqrt(square)
                            f = reflectance(closures, c, albedo, c_o / root, frame.entering)
                            # Walter et al. 2007, equation 17: its denominator is the half vector's squared length
                            jacobian = (eta * (c_o / root)) * (eta * (-c_i / root)) / square
                            pdf = visible_density(facets, wo, half) * jacobian
                            shadowed = pdf * shadowing(facets, wo, wi, -cos_i)
                            passed = wp.cw_mul(wp.vec3(1.0) - f, closures[c].refraction)
                            mixture.value += shadowed * wp.cw_mul(lobe.scale, passed)
                            mixture.density += lobe.selection * (glass_shares(closures, c, f)[1] * pdf)
        return mixture

    return MixtureFunctions(mix, glass_shares, reflected)
