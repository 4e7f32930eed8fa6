"""What all closures of a material make of a pair of directions together, and the normals that they are about.

wo and wi are unit and point away from the surface. Diffuse closures use the shading normal, and those of facets a normal that is
bent, where an interpolated one would mirror wo into the surface. Light does not leak: reflected directions are on the geometric
normal's side, refracted ones on the other, and everything else is 0.
"""

import functools
from typing import NamedTuple

import warp as wp

from ..scene.description import ClosureKind
from .albedo import AlbedoTables
from .facets import make_facets
from .lobes import make_lobes, relative_index
from .materials import ClosureFeatures, ClosureRecord, ShadingFrame
from .microfacet import is_refraction_specular, is_specular

_K = ClosureKind
_DIFFUSE = wp.constant(int(_K.DIFFUSE))
_LAYERED_DIFFUSE = wp.constant(int(_K.LAYERED_DIFFUSE))
_GLOSSY = wp.constant(int(_K.GLOSSY))
_METAL = wp.constant(int(_K.METAL))
_DIELECTRIC = wp.constant(int(_K.DIELECTRIC))
_GLASS = wp.constant(int(_K.GLASS))

# Share of wo's height above the triangle that a mirrored direction keeps at least, by bending the
# normal. A choice of look, as any treatment of interpolated normals; flat surfaces have the share 1.
_HEIGHT_KEPT = wp.constant(0.25)


class MixtureFunctions(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    mix: wp.Function  # (closures, first, end, albedo, frame, wo, wi) -> Mixture
    glass_reflects: wp.Function  # (closures, c: int, f: vec3) -> float: share of the samples of glass that a facet reflects


@wp.struct
class Mixture:
    """Sums over a material's closures for one pair of directions. pdf = (Lambertian + others) / selection."""

    diffuse: wp.vec3  # of Lambertian closures about the frame's normal: f |cos| but for the factor cos / pi
    diffuse_selection: float
    lambert: float  # that factor, which is their density too
    value: wp.vec3  # of other closures: f |cos|
    soft: wp.vec3  # the part of `value` that is diffuse
    density: float  # of other closures: selection * density
    selection: float  # of all closures


@wp.func
def facet_normal(n: wp.vec3, frame: ShadingFrame, wo: wp.vec3) -> wp.vec3:
    """Unit normal `n`, bent so that wo is above it and wo's mirror direction above the triangle.

    After Keller et al., "The Iray Light Transport Simulation and Rendering System" (2017), A.3.
    """
    c = wp.dot(n, wo)
    # a normal that faces away from wo is first turned to be perpendicular to it
    mirrored = 2.0 * wp.max(c, 0.0) * n - wo
    height = wp.dot(mirrored, frame.geometric_normal)
    least = _HEIGHT_KEPT * wp.dot(wo, frame.geometric_normal)
    if c > 0.0 and height >= least:
        return n
    return wp.normalize(wo + wp.normalize(mirrored + (least - height) * frame.geometric_normal))


@wp.func
def _bump_shadow(n: wp.vec3, frame: ShadingFrame, wi: wp.vec3) -> float:
    """What is left of diffuse light from `wi` where a normal `n` of its own tilts the facets of a surface.

    Without it light ends abruptly where the surface turns away (Conty Estevez, Lecocq and Stein, "A Microfacet-Based Shadowing
    Function to Solve the Bump Terminator Problem", 2019).
    """
    cos_d = wp.abs(wp.dot(frame.normal, n))
    cos_i = wp.dot(frame.normal, wi)
    if cos_d >= 1.0:
        return 1.0
    if cos_i <= 0.0:
        return 0.0
    if cos_i >= 1.0:
        return 1.0
    alpha2 = wp.min(0.125 * (1.0 / wp.max(cos_d * cos_d, 1.0e-20) - 1.0), 1.0)
    return 2.0 * cos_i / (cos_i + wp.sqrt(cos_i * cos_i + alpha2 * (1.0 - cos_i * cos_i)))


@functools.cache
def make_normals(own: bool) -> tuple[wp.Function, wp.Function]:
    """Functions (closures, c: int) -> bool: whether a closure has a normal of its own, and (closures, c: int, frame) -> vec3: its normal."""

    @wp.func
    def has_own_normal(closures: wp.array(dtype=ClosureRecord), c: int) -> bool:
        if wp.static(own):
            n = closures[c].normal
            return n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0
        return False

    @wp.func
    def own_normal(closures: wp.array(dtype=ClosureRecord), c: int, frame: ShadingFrame) -> wp.vec3:
        if has_own_normal(closures, c):
            return closures[c].normal
        return frame.normal

    return has_own_normal, own_normal


@functools.cache
def make_mixture(features: ClosureFeatures) -> MixtureFunctions:
    """The functions for closures of `features`."""
    has = features.has
    view, reflectance = make_lobes(features)
    mean_alpha, facets_of, visible_density, shadowing, _ = make_facets(features)
    has_glass = has(_K.GLASS)
    has_facets, has_coats = features.facets, features.coats
    has_lambert = has(_K.DIFFUSE, _K.LAYERED_DIFFUSE)
    bends = has_facets or has_coats
    own = features.own_normals
    has_own_normal, own_normal = make_normals(own)

    @wp.func
    def glass_reflects(closures: wp.array(dtype=ClosureRecord), c: int, f: wp.vec3) -> float:
        """Share of samples that a facet reflects, of those that it does not absorb."""
        passed = wp.cw_mul(wp.vec3(1.0) - f, closures[c].refraction)
        reflects = f[0] + f[1] + f[2]
        total = reflects + passed[0] + passed[1] + passed[2]
        if total > 0.0:
            return reflects / total
        return 1.0

    @wp.func
    def mix(
        closures: wp.array(dtype=ClosureRecord), first: int, end: int, albedo: AlbedoTables, frame: ShadingFrame, wo: wp.vec3, wi: wp.vec3
    ) -> Mixture:
        """All closures but their delta lobes; the selection counts delta lobes too."""
        mixture = Mixture()
        above = wp.dot(wi, frame.geometric_normal)
        mixture.lambert = wp.max(wp.dot(wi, frame.normal), 0.0) / wp.PI
        if above <= 0.0:
            mixture.lambert = 0.0
        n = frame.normal
        cos_o = float(1.0)
        if wp.static(bends and not own):
            n = facet_normal(frame.normal, frame, wo)
            cos_o = wp.dot(n, wo)
            if not cos_o > 0.0:  # wo lies in the triangle's plane
                return Mixture()
        for c in range(first, end):
            kind = closures[c].kind
            if wp.static(bends and own):
                n = facet_normal(own_normal(closures, c, frame), frame, wo)
                cos_o = wp.dot(n, wo)
                if not cos_o > 0.0:
                    return Mixture()
            lobe = view(closures, c, albedo, frame, cos_o)
            mixture.selection += lobe.selection
            if wp.static(has_lambert):
                if kind == _DIFFUSE or kind == _LAYERED_DIFFUSE:
                    if has_own_normal(closures, c):
                        about = own_normal(closures, c, frame)
                        cosine = wp.dot(wi, about)
                        if above > 0.0 and cosine > 0.0:
                            value = (_bump_shadow(about, frame, wi) * cosine / wp.PI) * lobe.scale
                            mixture.value += value
                            mixture.soft += value
                            mixture.density += lobe.selection * cosine / wp.PI
                    else:
                        mixture.diffuse += lobe.scale
                        mixture.diffuse_selection += lobe.selection
            if wp.static(has_facets):
                cos_i = wp.dot(n, wi)
                alpha = mean_alpha(closures, c)
                if cos_i > 0.0 and above > 0.0 and not is_specular(alpha):
                    if kind == _GLOSSY or kind == _METAL or kind == _DIELECTRIC or kind == _GLASS:
                        facets = facets_of(closures, c, n, cos_o)
                        half = wo + wi
                        cosine = wp.min(wp.length(half) * 0.5, 1.0)  # to either direction
                        pdf = 0.25 * visible_density(facets, wo, half)
                        shadowed = pdf * shadowing(facets, wo, wi, cos_i)
                        f = reflectance(closures, c, cosine, frame.entering)
                        if wp.static(has_glass):
                            if kind == _GLASS:
                                pdf = glass_reflects(closures, c, f) * pdf
                        mixture.value += shadowed * wp.cw_mul(lobe.scale, f)
                        mixture.density += lobe.selection * pdf
                if wp.static(has_glass):
                    if kind == _GLASS and cos_i < 0.0 and above < 0.0 and not is_specular(alpha):
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
                            f = reflectance(closures, c, c_o / root, frame.entering)
                            # Walter et al. 2007, equation 17: its denominator is the half vector's squared length
                            jacobian = (eta * (c_o / root)) * (eta * (-c_i / root)) / square
                            pdf = visible_density(facets, wo, half) * jacobian
                            shadowed = pdf * shadowing(facets, wo, wi, -cos_i)
                            passed = wp.cw_mul(wp.vec3(1.0) - f, closures[c].refraction)
                            mixture.value += shadowed * wp.cw_mul(lobe.scale, passed)
                            mixture.density += lobe.selection * ((1.0 - glass_reflects(closures, c, f)) * pdf)
        return mixture

    return MixtureFunctions(mix, glass_reflects)
