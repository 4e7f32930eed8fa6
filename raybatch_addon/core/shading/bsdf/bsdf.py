"""Evaluation and sampling of materials, compiled for the closure kinds of a scene alone.

A material is a range [first, end) of an array of `ClosureRecord`s: a part of the scene's table, or what a shader
program made. wo and wi are unit and point away from the surface.
"""

import functools

import warp as wp

from ...float32 import ONE_BELOW
from ...scene.description import ClosureKind
from ..hair.closures import with_hair
from ..sampling import bitangent_of, sample_cosine_hemisphere, spherical_direction, tangent_of, to_world
from .albedo import AlbedoTables
from .ashikhmin_shirley import phong_exponent, sample_phong
from .drawn.toon import sample_toon
from .facets import make_facets
from .ggx import is_refraction_specular, is_specular, reflected, refracted
from .lobes import LOBE_FLOATS, Lobe, make_lobes, pick_lobe, relative_index
from .materials import (
    DELTA,
    DIFFUSE,
    GLOSSY,
    MICROFACET_KINDS,
    PASSING_KINDS,
    PORTAL,
    SUBSURFACE,
    TRANSMISSION,
    TRANSPARENT,
    Bsdf,
    BsdfSample,
    BsdfValue,
    ClosureFeatures,
    ClosureRecord,
    MaterialTable,
    ShadingFrame,
    upload_materials,
)
from .mixture import LAMBERTIAN, SOFT, Mixture, make_mixture
from .normals import make_normals
from .sheen import sample_sheen, sheen_lobe, sheen_tangent

__all__ = [
    "DELTA",
    "DIFFUSE",
    "GLOSSY",
    "LOBE_FLOATS",
    "SUBSURFACE",
    "TRANSMISSION",
    "TRANSPARENT",
    "Bsdf",
    "BsdfSample",
    "BsdfValue",
    "ClosureFeatures",
    "ClosureRecord",
    "Lobe",
    "MaterialTable",
    "ShadingFrame",
    "make_bsdf",
    "upload_materials",
]

_K = ClosureKind
_GLASS = wp.constant(int(_K.GLASS))
_REFRACTION = wp.constant(int(_K.REFRACTION))
_TRANSPARENT = wp.constant(int(_K.TRANSPARENT))
_EMISSION = wp.constant(int(_K.EMISSION))
_TRANSLUCENT = wp.constant(int(_K.TRANSLUCENT))
_ASHIKHMIN_SHIRLEY = wp.constant(int(_K.ASHIKHMIN_SHIRLEY))
_SHEEN = wp.constant(int(_K.SHEEN))
_VELVET = wp.constant(int(_K.VELVET))
_HOLDOUT = wp.constant(int(_K.HOLDOUT))
_SHEET = wp.constant(int(_K.SHEET))
_SUBSURFACE = wp.constant(int(_K.SUBSURFACE))
_TOON = wp.constant(int(_K.TOON))
_RAY_PORTAL = wp.constant(int(_K.RAY_PORTAL))


@functools.cache
def make_bsdf(features: ClosureFeatures) -> Bsdf:
    """The functions for materials of `features.kinds`; nothing of other kinds is compiled."""
    has = features.has
    functions = make_lobes(features)
    reflectance = functions.reflectance
    mean_alpha, facets_of, _, _, sample_normal = make_facets(features)
    mix, glass_shares, reflected_share = make_mixture(features)
    is_lambertian, is_cosine = features.test(LAMBERTIAN), features.test((*LAMBERTIAN, _K.ROUGH_DIFFUSE, _K.TRANSLUCENT))
    is_soft, is_facets, is_passing = features.test(SOFT), features.test(MICROFACET_KINDS), features.test(PASSING_KINDS)
    has_lambert, has_cosine = has(*LAMBERTIAN), has(*LAMBERTIAN, _K.ROUGH_DIFFUSE, _K.TRANSLUCENT)
    has_transparent, has_emission, has_holdout = has(_K.TRANSPARENT), has(_K.EMISSION), has(_K.HOLDOUT)
    has_translucent, has_sheen, has_velvet = has(_K.TRANSLUCENT), has(_K.SHEEN), has(_K.VELVET)
    has_toon, has_portal = has(_K.TOON), has(_K.RAY_PORTAL)
    has_facets, has_passing, has_phong = features.facets, has(*PASSING_KINDS), has(_K.ASHIKHMIN_SHIRLEY)
    has_refraction, has_sheet, has_subsurface = has(_K.REFRACTION), has(_K.SHEET), has(_K.SUBSURFACE)
    has_evaluated_facets, is_evaluated_facets = (
        has(*MICROFACET_KINDS - {_K.SUBSURFACE}),
        features.test(MICROFACET_KINDS - {_K.SUBSURFACE}),
    )
    own = features.own_normals
    has_own_normal, own_normal = make_normals(own)

    @wp.func
    def value_of(mixture: Mixture) -> BsdfValue:
        result = BsdfValue()
        if mixture.selection > 0.0:
            result.value = mixture.value
            result.pdf = mixture.density
            result.diffuse = mixture.soft
            if wp.static(has_lambert):
                lambert = mixture.lambert * mixture.diffuse
                result.value += lambert
                result.diffuse += lambert
                result.pdf += mixture.lambert * mixture.diffuse_selection
            result.pdf = result.pdf / mixture.selection
        return result

    @wp.func
    def propose(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        u_lobe: float,
        u: wp.vec2,
    ) -> BsdfSample:
        result = BsdfSample()

        picked = pick_lobe(lobes, end - first, u_lobe)
        if picked.offset < 0:
            return result
        chosen = int(first + picked.offset)
        lobe = lobes[picked.offset]
        left = float(picked.rest)

        kind = closures[chosen].kind
        n = lobe.normal
        cos_o = lobe.cosine
        wi = -wo
        bits = int(0)
        delta = wp.vec3(0.0)  # weight of a delta lobe times the lobe's probability
        about = frame.normal
        tangent = frame.tangent
        bitangent = frame.bitangent
        if wp.static(own):
            if has_own_normal(closures, chosen):
                about = own_normal(closures, chosen, frame)
                tangent = tangent_of(about)
                bitangent = bitangent_of(about)
        if wp.static(has_cosine):
            if is_cosine(kind):
                local = sample_cosine_hemisphere(u)
                bits = DIFFUSE
                if wp.static(has_translucent):
                    if kind == _TRANSLUCENT:
                        local[2] = -local[2]
                        bits = DIFFUSE | TRANSMISSION
                wi = to_world(local, tangent, bitangent, about)
        if wp.static(has_sheen):
            if kind == _SHEEN:
                fibres = sheen_lobe(albedo.sheen, closures[chosen].roughness, wp.dot(about, wo))
                along = sheen_tangent(about, wo, tangent)
                wi = to_world(sample_sheen(fibres, u), along, wp.cross(about, along), about)
                bits = DIFFUSE
        if wp.static(has_velvet):
            if kind == _VELVET:
                wi = to_world(spherical_direction(u[1], wp.TAU * u[0]), tangent, bitangent, about)
                bits = DIFFUSE
        if wp.static(has_toon):
            if kind == _TOON:
                drawn = closures[chosen].distribution
                wi = sample_toon(drawn, closures[chosen].roughness, closures[chosen].mean_cosine, about, wo, u)
                bits = wp.where(drawn == 1, GLOSSY, DIFFUSE)
        if wp.static(has_transparent):
            if kind == _TRANSPARENT:
                bits = TRANSPARENT | DELTA
                delta = lobe.scale
        if wp.static(has_portal):
            if kind == _RAY_PORTAL:
                bits = PORTAL | TRANSPARENT | DELTA
                delta = lobe.scale
                ahead = closures[chosen].tangent
                if wp.dot(ahead, ahead) > 0.0:
                    wi = ahead
        if wp.static(has_facets):
            if is_facets(kind):
                alpha = mean_alpha(closures, chosen)
                h = n
                goes_in_diffusely = bool(False)
                if wp.static(has_subsurface):
                    if kind == _SUBSURFACE and closures[chosen].multiscatter == 1:
                        goes_in_diffusely = u[0] < 0.5
                        u = wp.vec2(wp.min(2.0 * wp.where(goes_in_diffusely, u[0], u[0] - 0.5), ONE_BELOW), u[1])
                if not is_specular(alpha):
                    facets = facets_of(closures, chosen, n, cos_o)
                    if kind != _ASHIKHMIN_SHIRLEY:
                        h = sample_normal(facets, wo, u)
                    if wp.static(has_phong):
                        if kind == _ASHIKHMIN_SHIRLEY:
                            along = tangent_of(n)
                            if facets.alpha_x != facets.alpha_y:
                                along = facets.tangent
                            local_half = sample_phong(phong_exponent(facets.alpha_x), phong_exponent(facets.alpha_y), u)
                            h = to_world(local_half, along, wp.cross(n, along), n)
                cosine = wp.max(wp.dot(wo, h), 0.0)
                f = reflectance(closures, chosen, albedo, cosine, frame.entering)
                bits = GLOSSY
                share = float(1.0)  # share of the samples that go this way
                if wp.static(has_refraction):
                    if kind == _REFRACTION and f[0] > 0.0:
                        return result  # total reflection, which this closure lacks
                if wp.static(has_passing):
                    if is_passing(kind):
                        eta = relative_index(closures[chosen].ior, frame.entering)
                        shares = glass_shares(closures, chosen, f)
                        share = shares[0]
                        if wp.static(features.half_glass):
                            if left < share:
                                f = reflected_share(closures, chosen, f)
                        if left >= share:
                            bits = TRANSMISSION
                            share = shares[1]
                            f = wp.cw_mul(wp.vec3(1.0) - f, closures[chosen].refraction)
                            if is_refraction_specular(alpha, eta):
                                h = n
                                bits = TRANSMISSION | DELTA
                            wi = refracted(wo, h, eta)
                            if wp.dot(wi, wi) == 0.0:
                                # the facet lets light through where the surface as a whole would not: the indices are
                                # so nearly equal that light is hardly bent
                                wi = -wo
                if wp.static(has_subsurface):
                    if kind == _SUBSURFACE:
                        bits = SUBSURFACE | DELTA
                        wi = refracted(wo, h, closures[chosen].ior)
                        if goes_in_diffusely:
                            wi = -to_world(sample_cosine_hemisphere(u), tangent_of(n), bitangent_of(n), n)
                if (bits & GLOSSY) != 0:
                    wi = wp.normalize(reflected(wo, h))
                    if is_specular(alpha):
                        bits = GLOSSY | DELTA
                    if wp.static(has_sheet):
                        if kind == _SHEET:
                            wi = wp.normalize(wi - (2.0 * wp.dot(wi, n)) * n)
                            bits = TRANSMISSION | (bits & DELTA)
                if (bits & DELTA) != 0:
                    delta = wp.cw_mul(lobe.scale, f / share)

        # A direction on a side that its lobe does not serve is absorbed: `mix` gives it no density there,
        # and another lobe's value must not be counted for it.
        side = wp.dot(wi, frame.geometric_normal)
        facet_side = side
        if wp.static(has_facets):
            if (bits & (GLOSSY | TRANSMISSION)) != 0 and (bits & DIFFUSE) == 0:
                facet_side = wp.dot(wi, n)
        if wp.static(has_toon):
            if kind == _TOON:
                facet_side = side
        if (bits & (TRANSMISSION | TRANSPARENT | SUBSURFACE)) != 0:
            side = -side
            facet_side = -facet_side
        if wp.static(has_portal):
            if kind == _RAY_PORTAL:  # which goes to either side
                side = float(1.0)
                facet_side = float(1.0)
        if not (side > 0.0 and facet_side > 0.0):
            return result

        result.direction = wi
        result.lobe = bits
        result.closure = chosen
        if (bits & DELTA) != 0:
            result.weight = (picked.total / lobe.selection) * delta
        return result

    @wp.func
    def complete(proposed: BsdfSample, mixture: Mixture) -> BsdfSample:
        result = BsdfSample()
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
            result.direction = proposed.direction
            result.lobe = proposed.lobe
            result.closure = proposed.closure
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
        """Whether any closure has a lobe that `mix` sees."""
        found = bool(False)
        for c in range(first, end):
            kind = closures[c].kind
            if is_lambertian(kind) or is_soft(kind):
                found = True
            if wp.static(has_evaluated_facets):
                if is_evaluated_facets(kind):
                    if not is_specular(mean_alpha(closures, c)):
                        found = True
        return found

    @wp.func
    def holdout(closures: wp.array(dtype=ClosureRecord), first: int, end: int) -> float:
        """Share of the surface that is a hole in the picture, in [0, 1]."""
        share = float(0.0)
        if wp.static(has_holdout):
            for c in range(first, end):
                if closures[c].kind == _HOLDOUT:
                    weight = closures[c].weight
                    share += (weight[0] + weight[1] + weight[2]) / 3.0
        return wp.min(share, 1.0)

    bsdf = Bsdf(
        look=functions.look,
        propose=propose,
        mix=mix,
        value=value_of,
        complete=complete,
        emission=emission,
        transparency=transparency,
        scatters=scatters,
        holdout=holdout,
    )
    return with_hair(bsdf, features)
