"""What layers of a surface leave to those below them, and other quantities that closures are made of.

A layer takes from all channels what it reflects of the one of which it reflects most, as seen from where the ray came.
"""

import warp as wp

from ..albedo import coat_fresnel, coat_fresnel_average, covering_index, energy_compensation, reflection_albedo
from ..film import FILM_LEAST, film_on_dielectric
from ..fresnel import fresnel_dielectric, normal_reflectance, tinted_dielectric
from ..materials import IOR_RANGE
from ..microfacet import is_specular
from ..normals import mirroring_normal
from ..sheen import sheen_lobe
from .closure_ops import is_black, unit_color, unit_number, usable_index, usable_normal, usable_weight
from .closure_ops_facets import FILM_IOR_LEAST, Distribution, film_thickness
from .op import NodeData, number, op, put_number, put_vector, vector
from .point import ShadingPoint

_REFLECTANCE_MOST = 0.99  # of a dielectric at normal incidence: no finite index of refraction has 1 (Blender's bound)


@wp.func
def below_layer(weight: wp.vec3, layer: wp.vec3) -> wp.vec3:
    """What is left of `weight` below a layer that reflects `layer`."""
    most = float(0.0)
    for i in range(3):
        if weight[i] > 0.0:
            most = wp.max(most, layer[i] / weight[i])
    return wp.max(1.0 - most, 0.0) * weight


@wp.func
def _seen_at(normal: wp.vec3, point: ShadingPoint) -> float:
    """Cosine of the viewer to `normal`, or to the surface's where that is 0."""
    n = normal
    if is_black(n):
        n = point.normal
    return wp.clamp(wp.dot(n, point.incoming), 0.0, 1.0)


@wp.func
def _facets_seen_at(normal: wp.vec3, point: ShadingPoint) -> float:
    """The same to the normal of facets, which is bent where it would mirror the viewer into the surface."""
    n = normal
    if is_black(n):
        n = point.normal
    return wp.clamp(wp.dot(mirroring_normal(n, point.geometric_normal, point.incoming), point.incoming), 0.0, 1.0)


@wp.func
def _reflected(data: NodeData, roughness: float, ior: float, cosine: float) -> float:
    """Mean reflectance of the facets of a dielectric of `ior` >= 1 that are seen."""
    if ior == 1.0:
        return 0.0
    if is_specular(roughness * roughness):
        return fresnel_dielectric(cosine, ior)
    return coat_fresnel(data.albedo, roughness, ior, wp.max(cosine, 1.0e-6))


@op("layer_sheen", "vnvnvvn>VVV", foldable=False)
@wp.func
def layer_sheen(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Fibres on top: weight, share, tint, roughness, the surface's normal, the coat's, the coat's share > weight of the fibres, of what is
    below, their normal."""
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
    """A coat of varnish: weight, share, roughness, index, tint, normal > weight of the coat, of what is below, the coat's index >= 1.

    The tint is that of light which crosses the coat once along its normal; on its way from the viewer it goes further.
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
    """What the closure `dielectric` leaves: weight, tint, distribution, roughness, index, normal > weight of what is below."""
    weight = usable_weight(vector(data, stack, pc + 1))
    tint = usable_weight(vector(data, stack, pc + 2))
    roughness = unit_number(number(data, stack, pc + 4))
    ior = usable_index(number(data, stack, pc + 5), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 6)), point)
    if ior != 1.0:
        layer = wp.cw_mul(weight, tinted_dielectric(_reflected(data, roughness, covering_index(ior), cosine), ior, tint))
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
    """What `dielectric` with a film leaves: weight, tint, index, normal, film's thickness [nm] and index > weight of what is below.

    Roughness is left out: what a film on rough facets reflects is not known beforehand. A film that is none leaves what a smooth
    surface would.
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
    """Behind a surface of `ior`, by Snell's law; 0 where all is reflected."""
    return wp.sqrt(wp.max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 0.0))


@wp.func
def _put_sheet(
    data: NodeData, stack: wp.array(dtype=float), at: int, weight: wp.vec3, color: wp.vec3, inside: float, front: wp.vec3, back: wp.vec3
):
    """The weights of what a sheet reflects and of what passes, to the words from `at` on.

    All bounces between surfaces that reflect `front` and `back` are added up; light crosses the sheet at the cosine `inside`.
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
    """A sheet of glass with both its surfaces: weight, colour of light that crosses it along its normal, tint of what a surface reflects at
    normal incidence, index, normal > weights of what it reflects and of what passes."""
    ior = usable_index(number(data, stack, pc + 4), wp.static(IOR_RANGE[0]))
    cosine = _facets_seen_at(usable_normal(vector(data, stack, pc + 5)), point)
    surface = tinted_dielectric(fresnel_dielectric(cosine, ior), ior, usable_weight(vector(data, stack, pc + 3)))
    weight = usable_weight(vector(data, stack, pc + 1))
    _put_sheet(data, stack, pc + 6, weight, unit_color(vector(data, stack, pc + 2)), _cosine_inside(cosine, ior), surface, surface)


@op("layer_thin_glass_film", "vvvnvnn>VV", foldable=False)
@wp.func
def layer_thin_glass_film(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The same with a film on both surfaces: its thickness [nm] and index come last."""
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
    """The index of refraction whose reflectance at normal incidence is twice the level (second) times that of an index (first)."""
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
    """Of light that crosses one of the two surfaces of what has a colour: the square root."""
    c = vector(data, stack, pc + 1)
    put_vector(
        data, stack, pc + 2, wp.vec3(wp.sqrt(unit_number(c[0])), wp.sqrt(unit_number(c[1])), wp.sqrt(unit_number(c[2])))
    )


@op("roughness_of_alpha", "n>N")
@wp.func
def roughness_of_alpha(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The roughness of facets whose slopes are told as alpha, its square."""
    put_number(data, stack, pc + 2, wp.sqrt(unit_number(number(data, stack, pc + 1))))


@op("forward_share", "nn>N")
@wp.func
def forward_share(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Of diffuse light, the share that a thin wall lets through: of the first, which scatters within it, by the second, how far it scatters
    ahead."""
    ahead = unit_number(0.5 + 0.5 * number(data, stack, pc + 2))
    put_number(data, stack, pc + 3, unit_number(number(data, stack, pc + 1)) * ahead)


@op("glossy_aspect", "n>N")
@wp.func
def glossy_aspect(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Alpha along the tangent over the mean, from a glossy anisotropy in [-1, 1]; none where it is small."""
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
    """The same from an anisotropy in [0, 1] of Principled and Metallic."""
    put_number(data, stack, pc + 2, 1.0 / wp.sqrt(1.0 - 0.9 * unit_number(number(data, stack, pc + 1))))


@op("rotate_tangent", "vvn>V", foldable=False)
@wp.func
def rotate_tangent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """A tangent turned about a normal (0: the surface's), by a number of turns."""
    tangent = vector(data, stack, pc + 1)
    axis = usable_normal(vector(data, stack, pc + 2))
    if is_black(axis):
        axis = point.normal
    angle = wp.TAU * number(data, stack, pc + 3)
    c = wp.cos(angle)
    turned = c * tangent + wp.sin(angle) * wp.cross(axis, tangent) + ((1.0 - c) * wp.dot(axis, tangent)) * axis
    put_vector(data, stack, pc + 4, turned)
