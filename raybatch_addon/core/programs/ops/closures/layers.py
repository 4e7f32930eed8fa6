"""Weights that layers of a surface leave to the layers below, and other quantities that closures are made of.

A layer reflects most of one channel; it takes that much from all channels, as seen from the ray's origin.
"""

import warp as wp

from ....shading.bsdf.albedo import (
    coat_fresnel,
    coat_fresnel_average,
    covering_index,
    energy_compensation,
    reflection_albedo,
)
from ....shading.bsdf.fresnel import fresnel_dielectric, normal_reflectance, tinted_dielectric
from ....shading.bsdf.ggx import is_specular
from ....shading.bsdf.materials import FILM_IOR_LEAST, IOR_RANGE
from ....shading.bsdf.normals import mirroring_normal
from ....shading.bsdf.sheen import sheen_lobe
from ....shading.bsdf.thin_film import FILM_LEAST, film_on_dielectric
from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .facets import Distribution, film_thickness
from .plain import is_black, unit_color, unit_number, usable_index, usable_normal, usable_weight

# largest reflectance of a dielectric at normal incidence: no finite index has 1 (Blender's bound)
_REFLECTANCE_MOST = 0.99


@wp.func
def below_layer(weight: wp.vec3, layer: wp.vec3) -> wp.vec3:
    """`weight` below a layer that reflects `layer`."""
    most = float(0.0)
    for i in range(3):
        if weight[i] > 0.0:
            most = wp.max(most, layer[i] / weight[i])
    return wp.max(1.0 - most, 0.0) * weight


@wp.func
def _seen_at(normal: wp.vec3, point: ShadingPoint) -> float:
    """Cosine of the viewer to `normal`, or to the surface's normal where that is 0."""
    n = normal
    if is_black(n):
        n = point.normal
    return wp.clamp(wp.dot(n, point.incoming), 0.0, 1.0)


@wp.func
def _facets_seen_at(normal: wp.vec3, point: ShadingPoint) -> float:
    """Cosine of the viewer to the normal of facets, which is bent where it would mirror the viewer into the surface."""
    n = normal
    if is_black(n):
        n = point.normal
    return wp.clamp(wp.dot(mirroring_normal(n, point.geometric_normal, point.incoming), point.incoming), 0.0, 1.0)


@wp.func
def _reflected(data: NodeData, roughness: float, ior: float, cosine: float) -> float:
    """Mean reflectance of the visible facets of a dielectric of `ior` >= 1."""
    if ior == 1.0:
        return 0.0
    if is_specular(roughness * roughness):
        return fresnel_dielectric(cosine, ior)
    return coat_fresnel(data.albedo, roughness, ior, wp.max(cosine, 1.0e-6))


@op("layer_sheen", "vnvnvvn>VVV", foldable=False)
@wp.func
def layer_sheen(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Fibres on top.

    Operands: weight, share, tint, roughness, the surface's normal, the coat's normal, the coat's share > weight of the
    fibres, weight of the layers below, the fibres' normal.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    share = wp.max(number(data, stack, pc + 2), 0.0)
    fibres = usable_weight(share * wp.cw_mul(usable_weight(vector(data, stack, pc + 3)), weight))
    base = usable_normal(vector(data, stack, pc + 5))
    coat = usable_normal(vector(data, stack, pc + 6))
    normal = wp.vec3(0.0)
    if not (is_black(base) and is_black(coat)):
        if is_black(base):
            base = point.normal
        if is_black(coat):
            coat = point.normal
        between = unit_number(number(data, stack, pc + 7))
        normal = usable_normal((1.0 - between) * base + between * coat)
    albedo = sheen_lobe(data.albedo.sheen, unit_number(number(data, stack, pc + 4)), _seen_at(normal, point))[0]
    put_vector(data, stack, pc + 8, fibres)
    put_vector(data, stack, pc + 9, below_layer(weight, albedo * fibres))
    put_vector(data, stack, pc + 10, normal)


@op("layer_coat", "vnnnvv>VVN", foldable=False)
@wp.func
def layer_coat(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """A coat of varnish.

    Operands: weight, share, roughness, index, tint, normal > weight of the coat, weight of the layers below, the coat's
    index >= 1. The tint is the colour of light that crosses the coat once along its normal; on its way from the viewer
    light goes further.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    share = wp.max(number(data, stack, pc + 2), 0.0)
    roughness = unit_number(number(data, stack, pc + 3))
    ior = usable_index(number(data, stack, pc + 4), 1.0)
    tint = usable_weight(vector(data, stack, pc + 5))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 6)), point)
    coat = usable_weight(share * weight)
    below = below_layer(weight, _reflected(data, roughness, ior, cosine) * coat)
    inside = wp.sqrt(wp.max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 1.0e-12))
    passed = wp.vec3(1.0)
    for i in range(3):
        if tint[i] != 1.0:
            through = float(0.0)
            if tint[i] > 0.0:
                through = wp.pow(tint[i], 1.0 / inside)
            passed[i] = wp.max(1.0 + share * (through - 1.0), 0.0)
    put_vector(data, stack, pc + 7, coat)
    put_vector(data, stack, pc + 8, wp.cw_mul(below, passed))
    put_number(data, stack, pc + 9, ior)


@op("layer_specular", "vvinnv>V", foldable=False)
@wp.func
def layer_specular(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Light that the closure `dielectric` leaves to the layers below.

    Operands: weight, tint, distribution, roughness, index, normal > weight of the layers below.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    tint = usable_weight(vector(data, stack, pc + 2))
    roughness = unit_number(number(data, stack, pc + 4))
    ior = usable_index(number(data, stack, pc + 5), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 6)), point)
    if ior != 1.0:
        layer = wp.cw_mul(
            weight, tinted_dielectric(_reflected(data, roughness, covering_index(ior), cosine), ior, tint)
        )
        if data.code[pc + 3] == wp.static(int(Distribution.MULTI_GGX)) and not is_specular(roughness * roughness):
            mean = tinted_dielectric(coat_fresnel_average(data.albedo, ior), ior, tint)
            cosine = wp.max(cosine, 1.0e-6)
            factor = energy_compensation(data.albedo, roughness, cosine, wp.min(mean, wp.vec3(1.0)))
            layer = reflection_albedo(data.albedo, roughness, cosine) * wp.cw_mul(layer, factor)
        weight = below_layer(weight, layer)
    put_vector(data, stack, pc + 7, weight)


@op("layer_film", "vvnvnn>V", foldable=False)
@wp.func
def layer_film(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Light that `dielectric` with a film leaves to the layers below.

    Operands: weight, tint, index, normal, film's thickness [nm] and index > weight of the layers below. There is no
    roughness: the reflectance of a film on rough facets is not known beforehand. A film of no thickness leaves as much
    as a smooth surface.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    tint = usable_weight(vector(data, stack, pc + 2))
    ior = usable_index(number(data, stack, pc + 3), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 4)), point)
    film = film_thickness(data, stack, pc + 5)
    layer = tinted_dielectric(fresnel_dielectric(cosine, covering_index(ior)), ior, tint)
    if film > wp.static(FILM_LEAST):
        index = usable_index(number(data, stack, pc + 6), wp.static(FILM_IOR_LEAST))
        layer = film_on_dielectric(data.albedo.film, film, index, ior, tint, cosine)
    put_vector(data, stack, pc + 7, below_layer(weight, wp.cw_mul(weight, layer)))


@wp.func
def _cosine_inside(cosine: float, ior: float) -> float:
    """Cosine behind a surface of `ior`, by Snell's law; 0 where all light is reflected."""
    return wp.sqrt(wp.max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 0.0))


@wp.func
def _put_sheet(
    data: NodeData,
    stack: wp.array(dtype=float),
    at: int,
    weight: wp.vec3,
    color: wp.vec3,
    inside: float,
    front: wp.vec3,
    back: wp.vec3,
):
    """Write the weights of reflection and of transmission by a sheet to the words from `at` on.

    All bounces between surfaces that reflect `front` and `back` are added up; light crosses the sheet at the cosine
    `inside`.
    """
    reflected = wp.vec3(0.0)
    passed = wp.vec3(0.0)
    for i in range(3):
        r = wp.clamp(front[i], 0.0, 1.0)
        r2 = wp.clamp(back[i], 0.0, 1.0)
        absorbed = float(0.0)
        if color[i] > 0.0 and inside > 0.0:
            absorbed = wp.pow(color[i], 1.0 / inside)
        bounced = r2 * absorbed
        if bounced < 1.0:
            passed[i] = absorbed * (1.0 - r) * (1.0 - r2) / (1.0 - bounced * bounced)
        reflected[i] = r + passed[i] * bounced
    put_vector(data, stack, at, wp.cw_mul(weight, reflected))
    put_vector(data, stack, at + 1, wp.cw_mul(weight, passed))


@op("layer_thin_glass", "vvvnv>VV", foldable=False)
@wp.func
def layer_thin_glass(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """A sheet of glass with both its surfaces.

    Operands: weight, colour of light that crosses the sheet along its normal, tint of a surface's reflection at normal
    incidence, index, normal > weights of reflection and of transmission.
    """
    ior = usable_index(number(data, stack, pc + 4), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 5)), point)
    surface = tinted_dielectric(fresnel_dielectric(cosine, ior), ior, usable_weight(vector(data, stack, pc + 3)))
    weight = usable_weight(vector(data, stack, pc + 1))
    _put_sheet(
        data,
        stack,
        pc + 6,
        weight,
        unit_color(vector(data, stack, pc + 2)),
        _cosine_inside(cosine, ior),
        surface,
        surface,
    )


@op("layer_thin_glass_film", "vvvnvnn>VV", foldable=False)
@wp.func
def layer_thin_glass_film(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """A sheet of glass with a film on both surfaces.

    The operands are those of `layer_thin_glass`, then the film's thickness [nm] and index.
    """
    tint = usable_weight(vector(data, stack, pc + 3))
    ior = usable_index(number(data, stack, pc + 4), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 5)), point)
    inside = _cosine_inside(cosine, ior)
    film = film_thickness(data, stack, pc + 6)
    front = tinted_dielectric(fresnel_dielectric(cosine, ior), ior, tint)
    back = front
    if film > wp.static(FILM_LEAST):
        index = usable_index(number(data, stack, pc + 7), wp.static(FILM_IOR_LEAST))
        front = film_on_dielectric(data.albedo.film, film, index, ior, tint, cosine)
        back = film_on_dielectric(data.albedo.film, film, index / ior, 1.0 / ior, tint, inside)
    weight = usable_weight(vector(data, stack, pc + 1))
    _put_sheet(data, stack, pc + 8, weight, unit_color(vector(data, stack, pc + 2)), inside, front, back)


@op("specular_index", "nn>N")
@wp.func
def specular_index(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Index whose reflectance at normal incidence is a multiple of another's: index, level > index.

    The factor is twice the level.
    """
    ior = usable_index(number(data, stack, pc + 1), 1.0e-5)
    level = wp.max(number(data, stack, pc + 2), 0.0)
    result = ior
    if level != 0.5:
        root = wp.sqrt(wp.min(2.0 * level * normal_reflectance(ior), wp.static(_REFLECTANCE_MOST)))
        result = (1.0 + root) / (1.0 - root)
        if ior < 1.0:
            result = 1.0 / result
    put_number(data, stack, pc + 3, result)


@op("refraction_tint", "v>V")
@wp.func
def refraction_tint(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Tint of light that crosses one of two surfaces: the square root of the colour of both."""
    c = vector(data, stack, pc + 1)
    put_vector(
        data, stack, pc + 2, wp.vec3(wp.sqrt(unit_number(c[0])), wp.sqrt(unit_number(c[1])), wp.sqrt(unit_number(c[2])))
    )


@op("roughness_of_alpha", "n>N")
@wp.func
def roughness_of_alpha(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Roughness of facets from alpha, its square."""
    put_number(data, stack, pc + 2, wp.sqrt(unit_number(number(data, stack, pc + 1))))


@op("forward_share", "nn>N")
@wp.func
def forward_share(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Share of diffuse light that a thin wall lets through.

    Operands: share of light that scatters within the wall, how far it scatters ahead > share.
    """
    ahead = unit_number(0.5 + 0.5 * number(data, stack, pc + 2))
    put_number(data, stack, pc + 3, unit_number(number(data, stack, pc + 1)) * ahead)


@op("glossy_aspect", "n>N")
@wp.func
def glossy_aspect(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Alpha along the tangent over the mean, from a glossy anisotropy in [-1, 1]; 1 where that is small."""
    anisotropy = wp.clamp(number(data, stack, pc + 1), -0.99, 0.99)
    aspect = float(1.0)
    if anisotropy > 1.0e-4:
        aspect = 1.0 - anisotropy
    if anisotropy < -1.0e-4:
        aspect = 1.0 / (1.0 + anisotropy)
    put_number(data, stack, pc + 2, aspect)


@op("principled_aspect", "n>N")
@wp.func
def principled_aspect(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Alpha along the tangent over the mean, from an anisotropy in [0, 1] of Principled and Metallic."""
    put_number(data, stack, pc + 2, 1.0 / wp.sqrt(1.0 - 0.9 * unit_number(number(data, stack, pc + 1))))


@op("rotate_tangent", "vvn>V", foldable=False)
@wp.func
def rotate_tangent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Tangent turned about a normal (0: the surface's), by a number of turns."""
    tangent = vector(data, stack, pc + 1)
    axis = usable_normal(vector(data, stack, pc + 2))
    if is_black(axis):
        axis = point.normal
    angle = wp.TAU * number(data, stack, pc + 3)
    c = wp.cos(angle)
    turned = c * tangent + wp.sin(angle) * wp.cross(axis, tangent) + ((1.0 - c) * wp.dot(axis, tangent)) * axis
    put_vector(data, stack, pc + 4, turned)
