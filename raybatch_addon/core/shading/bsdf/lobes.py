"""Closures as seen from wo: their colour, and how often to sample them.

The colour includes energy compensation and what layers above let through.
"""

import functools
from typing import NamedTuple

import warp as wp

from ...float32 import ONE_BELOW
from ...scene.description import ClosureKind
from .albedo import (
    AlbedoTables,
    coat_albedo,
    coat_fresnel,
    coat_fresnel_average,
    covering_index,
    energy_compensation,
    glass_compensation,
    reflection_albedo,
)
from .facets import make_facets
from .fresnel import (
    conductor_average,
    f82_average,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_f82,
    tinted_dielectric,
)
from .ggx import ggx_slope, is_refraction_specular, is_specular
from .materials import MICROFACET_KINDS, REFLECTION_KINDS, ClosureFeatures, ClosureRecord, ShadingFrame
from .normals import facet_normal, make_normals
from .sheen import sheen_lobe
from .thin_film import FILM_LEAST, film_on_conductor, film_on_dielectric, film_on_f82

_K = ClosureKind
_LAYERED_DIFFUSE = wp.constant(int(_K.LAYERED_DIFFUSE))
_METAL = wp.constant(int(_K.METAL))
_DIELECTRIC = wp.constant(int(_K.DIELECTRIC))
_GLASS = wp.constant(int(_K.GLASS))
_REFRACTION = wp.constant(int(_K.REFRACTION))
_CONDUCTOR = wp.constant(int(_K.CONDUCTOR))
_SHEEN = wp.constant(int(_K.SHEEN))
_VELVET = wp.constant(int(_K.VELVET))
# An estimate of velvet's albedo, which is not known; it only decides how often velvet is sampled
_VELVET_ALBEDO = 0.3
# Least cosine at which a coat's albedo is looked up; a closure's own normal may be turned away from wo
_COSINE_LEAST = wp.constant(1.0e-6)


class LobeFunctions(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    # (closures, first, end, albedo, frame, wo, lobes: array of Lobe) writes the closures, in order, to `lobes`
    look: wp.Function
    # (closures, c: int, albedo, cosine: float, entering: int) -> vec3: share of light that a facet reflects
    reflectance: wp.Function
    mirror: (
        wp.Function
    )  # (closures, c: int, albedo, entering: int, cosine: float) -> MirrorAlbedo, of `REFLECTION_KINDS`


@wp.struct
class Lobe:
    """A closure as it is seen from wo."""

    scale: wp.vec3  # weight times energy compensation, times the share of light that a coat above lets through
    selection: float  # albedo, approximate, summed over the channels: decides how often the closure is sampled
    normal: wp.vec3  # of its facets, unit
    cosine: float  # of the angle between that and wo


@wp.struct
class PickedLobe:
    """The closure that a random number chooses."""

    offset: int  # behind the first; -1: none is sampled
    rest: float  # what is left of the number, in [0, 1)
    total: float  # `selection` of all


@wp.func
def pick_lobe(lobes: wp.array(dtype=Lobe), count: int, u: float) -> PickedLobe:
    """Choose one of `count` lobes in proportion to `selection` by `u` in [0, 1).

    Each has one interval of `u`, in their order. What is left of `u` grows from 0 to 1 in the first one, and falls from
    1 to 0 in all others: so what is rare in the first or the last closure lies at an end of [0, 1), where the evenly
    spaced numbers of each pixel find it equally often.
    """
    picked = PickedLobe()
    picked.offset = -1
    for c in range(count):
        picked.total += wp.max(lobes[c].selection, 0.0)
    start = float(0.0)
    width = float(1.0)
    below = float(0.0)
    for c in range(count):
        selection = lobes[c].selection
        if selection > 0.0:
            if picked.offset < 0 or u * picked.total >= below:
                picked.offset = int(c)
                start = below
                width = selection
            below += selection
    picked.rest = (u * picked.total - start) / width
    if start > 0.0:
        picked.rest = 1.0 - picked.rest
    picked.rest = wp.clamp(picked.rest, 0.0, ONE_BELOW)
    return picked


@wp.struct
class MirrorAlbedo:
    """How facets that let nothing through reflect, as they are seen from wo; the product of all is their albedo."""

    compensation: wp.vec3  # factor for light that bounces more than once between facets
    single: float  # albedo of facets that reflect all light, by single scattering
    seen: wp.vec3  # share of light that they reflect, approximate


# Floats of a lobe: kernels reserve a local array of lobes as one of closure records (`RECORD_FLOATS`)
LOBE_FLOATS = Lobe.numpy_dtype()["itemsize"] // 4


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
    # kinds whose albedo is their weight, or about that
    is_plain = features.test(
        (
            _K.DIFFUSE,
            _K.TRANSPARENT,
            _K.ROUGH_DIFFUSE,
            _K.TRANSLUCENT,
            _K.REFRACTION,
            _K.ASHIKHMIN_SHIRLEY,
            _K.SUBSURFACE,
            _K.TOON,
            _K.RAY_PORTAL,
        )
    )
    is_mirror, is_facets = features.test(REFLECTION_KINDS), features.test(MICROFACET_KINDS)
    has_layered, has_metal, has_dielectric, has_conductor = (
        has(kind) for kind in (_K.LAYERED_DIFFUSE, _K.METAL, _K.DIELECTRIC, _K.CONDUCTOR)
    )
    has_mirror = has(*REFLECTION_KINDS)
    has_glass, has_refraction, has_sheen, has_velvet = has(_K.GLASS), has(_K.REFRACTION), has(_K.SHEEN), has(_K.VELVET)
    has_film = has(_K.THIN_FILM)
    has_dielectrics = has_glass or has_refraction or has_dielectric
    bends, own = features.facets or features.coats, features.own_normals
    _, own_normal = make_normals(own)

    mean_alpha = make_facets(features).alpha
    alike = not has(_K.ANISOTROPIC)

    @wp.func
    def table_roughness(closures: wp.array(dtype=ClosureRecord), c: int) -> float:
        """Roughness of isotropic facets with as wide a spread of slopes."""
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
        ior = covering_index(closures[c].ior)
        if is_specular(roughness * roughness):
            return fresnel_dielectric(cos_o, ior)
        if closures[c].multiscatter == 0:
            # light that facets hide from each other is lost to the layer below as well, as in Cycles
            return coat_fresnel(tables, roughness, ior, cos_o)
        mean = wp.vec3(coat_fresnel_average(tables, closures[c].ior))
        factor = energy_compensation(tables, roughness, cos_o, mean)[0]
        return coat_albedo(tables, roughness, ior, cos_o) * factor

    @wp.func
    def compensated(
        closures: wp.array(dtype=ClosureRecord),
        c: int,
        tables: AlbedoTables,
        roughness: float,
        cos_o: float,
        mean: wp.vec3,
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
    def bare_reflectance(closures: wp.array(dtype=ClosureRecord), c: int, cosine: float, entering: int) -> wp.vec3:
        """`reflectance` of a facet without a thin film."""
        kind = closures[c].kind
        f = wp.vec3(1.0)
        if wp.static(has_metal):
            if kind == _METAL:
                f = fresnel_f82(closures[c].color, closures[c].edge, cosine)
        if wp.static(has_conductor):
            if kind == _CONDUCTOR:
                f = fresnel_conductor(closures[c].color, closures[c].edge, cosine)
        if wp.static(has_dielectrics):
            if kind == _DIELECTRIC or kind == _GLASS or kind == _REFRACTION:
                eta = closures[c].ior
                if kind != _DIELECTRIC:
                    eta = relative_index(eta, entering)
                white = fresnel_dielectric(cosine, eta)
                f = tinted_dielectric(white, eta, closures[c].edge)
                if wp.static(has_refraction):
                    if kind == _REFRACTION:
                        f = wp.vec3(wp.where(white < 1.0, 0.0, 1.0))
        return f

    @wp.func
    def reflectance(
        closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, cosine: float, entering: int
    ) -> wp.vec3:
        """Share of light at `cosine` that a facet of closure `c` reflects."""
        if wp.static(has_film):
            thickness = closures[c].film_thickness
            if thickness > wp.static(FILM_LEAST):
                kind = closures[c].kind
                index = closures[c].film_ior
                if wp.static(has_metal):
                    if kind == _METAL:
                        return film_on_f82(tables.film, thickness, index, closures[c].color, closures[c].edge, cosine)
                if wp.static(has_conductor):
                    if kind == _CONDUCTOR:
                        return film_on_conductor(
                            tables.film, thickness, index, closures[c].color, closures[c].edge, cosine
                        )
                if wp.static(has_dielectric or has_glass):
                    if kind == _DIELECTRIC or kind == _GLASS:
                        eta = closures[c].ior
                        # the light is inside: both indices become relative to the inside
                        if kind == _GLASS and entering == 0:
                            index = index / eta
                            eta = 1.0 / eta
                        return film_on_dielectric(tables.film, thickness, index, eta, closures[c].edge, cosine)
        return bare_reflectance(closures, c, cosine, entering)

    @wp.func
    def mirror(
        closures: wp.array(dtype=ClosureRecord), c: int, tables: AlbedoTables, entering: int, cos_o: float
    ) -> MirrorAlbedo:
        """Closure `c`, one of `REFLECTION_KINDS`, seen at `cos_o` to the facets' normal."""
        kind = closures[c].kind
        roughness = table_roughness(closures, c)
        mean = closures[c].color
        seen = wp.vec3(1.0)
        if wp.static(has_metal):
            if kind == _METAL:
                mean = f82_average(closures[c].color, closures[c].edge)
                seen = fresnel_f82(closures[c].color, closures[c].edge, cos_o)
        if wp.static(has_conductor):
            if kind == _CONDUCTOR:
                mean = conductor_average(closures[c].color, closures[c].edge)
                seen = fresnel_conductor(closures[c].color, closures[c].edge, cos_o)
        if wp.static(has_dielectric):
            if kind == _DIELECTRIC:
                ior = closures[c].ior
                mean = tinted_dielectric(coat_fresnel_average(tables, ior), ior, closures[c].edge)
                seen_white = fresnel_dielectric(cos_o, ior)
                if not is_specular(roughness * roughness):
                    if ior < 1.0:  # approximate, for want of a table: some facets always reflect totally
                        seen_white = fresnel_dielectric(ggx_slope(roughness * roughness, cos_o), ior)
                        seen_white = 0.5 * (seen_white + coat_fresnel_average(tables, ior))
                    else:
                        seen_white = coat_fresnel(tables, roughness, ior, cos_o)
                seen = tinted_dielectric(seen_white, ior, closures[c].edge)
        if wp.static(has_film):
            if closures[c].film_thickness > wp.static(FILM_LEAST):
                seen = reflectance(closures, c, tables, cos_o, entering)
        m = compensated(closures, c, tables, roughness, cos_o, mean)
        result = MirrorAlbedo()
        result.compensation = wp.vec3(m[0], m[1], m[2])
        result.single = m[3]
        result.seen = seen
        return result

    @wp.func
    def view_lobe(
        closures: wp.array(dtype=ClosureRecord),
        c: int,
        tables: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        cos_o: float,
    ) -> Lobe:
        """Closure `c` seen at `cos_o` to the facets' normal; 0 for facets that are turned away."""
        lobe = Lobe()
        kind = closures[c].kind
        if wp.static(features.own_normals):
            if is_facets(kind) and not cos_o > 0.0:
                return lobe
        weight = closures[c].weight
        albedo = wp.vec3(0.0)
        if is_plain(kind):
            lobe.scale = weight
            albedo = weight
        if wp.static(has_layered):
            if kind == _LAYERED_DIFFUSE:
                lobe.scale = (
                    wp.max(1.0 - coat_reflects(closures, c, tables, wp.max(cos_o, _COSINE_LEAST)), 0.0) * weight
                )
                albedo = lobe.scale
        if wp.static(has_mirror):
            if is_mirror(kind):
                facets = mirror(closures, c, tables, frame.entering, cos_o)
                lobe.scale = wp.cw_mul(weight, facets.compensation)
                albedo = facets.single * wp.cw_mul(lobe.scale, facets.seen)
        if wp.static(has_glass):
            if kind == _GLASS:
                roughness = closures[c].roughness
                eta = relative_index(closures[c].ior, frame.entering)
                lobe.scale = weight
                # where refraction is not blurred, facets do not hide light from each other either
                if closures[c].multiscatter == 1 and not is_refraction_specular(roughness * roughness, eta):
                    bounded = wp.min(closures[c].color, wp.vec3(1.0))
                    lobe.scale = wp.cw_mul(weight, glass_compensation(tables, roughness, eta, cos_o, bounded))
                albedo = weight
        if wp.static(has_sheen):
            if kind == _SHEEN:
                fibres = sheen_lobe(tables.sheen, closures[c].roughness, wp.dot(own_normal(closures, c, frame), wo))
                lobe.scale = fibres[0] * weight
                albedo = lobe.scale
        if wp.static(has_velvet):
            if kind == _VELVET:
                lobe.scale = weight
                albedo = wp.static(_VELVET_ALBEDO) * weight
        lobe.selection = _sum(albedo)
        return lobe

    @wp.func
    def look(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        tables: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        lobes: wp.array(dtype=Lobe),
    ):
        """The closures [first, end) as seen from wo; black where wo lies in the triangle's plane."""
        n = frame.normal
        cos_o = float(1.0)
        if wp.static(bends and not own):
            n = facet_normal(frame.normal, frame, wo)
            cos_o = wp.dot(n, wo)
        for c in range(first, end):
            if wp.static(bends and own):
                n = facet_normal(own_normal(closures, c, frame), frame, wo)
                cos_o = wp.dot(n, wo)
            lobe = Lobe()
            if wp.static(own or not bends) or cos_o > 0.0:
                lobe = view_lobe(closures, c, tables, frame, wo, cos_o)
            lobe.normal = n
            lobe.cosine = cos_o
            lobes[c - first] = lobe

    return LobeFunctions(look, reflectance, mirror)
