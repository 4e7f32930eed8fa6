"""Ops that make closures of hair, and the absorption of fibres."""

import warp as wp

from ....float32 import PI
from ....scene.description import ClosureKind
from ....shading.bsdf.materials import ClosureRecord, new_closure
from ....shading.sampling import tangent_of
from ...op import NodeData, closure_op, number, op, put_vector, vector
from ...point import ShadingPoint
from ..inputs.curve_inputs import curve_tangent
from .plain import begins, usable_index, usable_weight

# Widths of lobes, and roughnesses, are in this range
_LEAST, _MOST = 0.001, 1.0


@wp.func
def _finite(x: float) -> float:
    return wp.where(wp.isfinite(x), x, 0.0)


@wp.func
def _width(x: float) -> float:
    return wp.clamp(_finite(x), wp.static(_LEAST), wp.static(_MOST))


@wp.func
def _lobe(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    kind: int,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    w = usable_weight(vector(data, stack, pc + 1))
    if not begins(w, closures, count):
        return count
    record = new_closure(kind, w)
    record.roughness = _width(number(data, stack, pc + 2))
    record.aspect = _width(number(data, stack, pc + 3))
    record.tangent = curve_tangent(data, point)
    record.film_ior = 0.0
    if wp.dot(record.tangent, record.tangent) > 0.5:  # surfaces of meshes are not shifted
        record.film_ior = -_finite(number(data, stack, pc + 4))
    given = vector(data, stack, pc + 5)
    if wp.dot(given, given) > 0.0 and wp.isfinite(wp.dot(given, given)):
        record.tangent = wp.normalize(given)
    closures[count] = record
    return count + 1


@closure_op("hair_reflection", "vnnnv", foldable=False)
@wp.func
def hair_reflection(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Light that a fibre reflects: weight, roughness along it and around it, shift [rad], tangent (0: the curve's)."""
    return _lobe(data, stack, pc, point, wp.static(int(ClosureKind.HAIR_REFLECTION)), closures, count)


@closure_op("hair_transmission", "vnnnv", foldable=False)
@wp.func
def hair_transmission(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Light that passes a fibre: weight, roughness along it and around it, shift [rad], tangent (0: the curve's)."""
    return _lobe(data, stack, pc, point, wp.static(int(ClosureKind.HAIR_TRANSMISSION)), closures, count)


@wp.func
def variance_along(roughness: float) -> float:
    """Variance along a fibre of a roughness 0..1 (Chiang et al. 2016, equation 7)."""
    x = 0.726 * roughness + 0.812 * roughness * roughness + 3.7 * wp.pow(roughness, 20.0)
    return x * x


@wp.func
def scale_around(roughness: float) -> float:
    """Scale of the logistic distribution around a fibre of a roughness 0..1 (equation 8)."""
    x = 0.265 * roughness + 1.194 * roughness * roughness + 5.372 * wp.pow(roughness, 22.0)
    return wp.static((PI / 8.0) ** 0.5) * x


@closure_op("principled_hair", "vvnnnnn", foldable=False)
@wp.func
def principled_hair(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """A fibre that absorbs: weight, absorption, roughness along it and around it, coat, index, tilt [rad]."""
    w = usable_weight(vector(data, stack, pc + 1))
    if not begins(w, closures, count):
        return count
    record = new_closure(wp.static(int(ClosureKind.PRINCIPLED_HAIR)), w)
    record.color = usable_weight(vector(data, stack, pc + 2))
    along = _width(number(data, stack, pc + 3))
    around = _width(number(data, stack, pc + 4))
    coat = wp.clamp(_finite(number(data, stack, pc + 5)), 0.0, 1.0)
    record.roughness = variance_along(along)
    record.aspect = scale_around(around)
    record.mean_cosine = variance_along(_width((1.0 - coat) * along))
    record.ior = usable_index(number(data, stack, pc + 6), 1.0e-3)
    record.film_ior = -_finite(number(data, stack, pc + 7))
    record.tangent = curve_tangent(data, point)
    closures[count] = record
    return count + 1


@closure_op("facet_hair", "vvnnnnvv", foldable=False, general=False)
@wp.func
def facet_hair(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """A fibre of facets that absorbs: weight, absorption, roughness, minor over major axis, index, tilt [rad], factors
    of what is reflected, passes and is reflected inside, direction of the major axis (0: none in particular).

    Beside an ellipse, which is narrower than the curve seen from its sharp end, the curve is transparent.
    """
    w = usable_weight(vector(data, stack, pc + 1))
    if not begins(w, closures, count):
        return count
    factors = usable_weight(vector(data, stack, pc + 7))
    if factors[0] + factors[1] + factors[2] <= 0.0:
        return count
    record = new_closure(wp.static(int(ClosureKind.FACET_HAIR)), w)
    record.color = usable_weight(vector(data, stack, pc + 2))
    record.roughness = _width(number(data, stack, pc + 3))
    aspect = wp.max(_finite(number(data, stack, pc + 4)), wp.static(_LEAST))
    record.aspect = wp.min(aspect, 1.0 / aspect)
    record.ior = usable_index(number(data, stack, pc + 5), 1.0e-3)
    record.film_ior = -_finite(number(data, stack, pc + 6))
    record.edge = factors
    record.tangent = curve_tangent(data, point)
    record.normal = wp.vec3(0.0)
    along = record.tangent
    if record.aspect != 1.0 and wp.dot(along, along) > 0.5:
        major = vector(data, stack, pc + 8)
        major = major - wp.dot(major, along) * along
        size = wp.length(major)
        if size > 0.0 and wp.isfinite(size):
            record.normal = major / size
        else:
            record.normal = tangent_of(along)
        # the half width of the ellipse that is seen, and where on it the curve was met
        seen = point.incoming - wp.dot(point.incoming, along) * along
        across = wp.dot(seen, record.normal)
        share = across * across / wp.max(wp.dot(seen, seen), 1.0e-20)
        beside = wp.cross(along, seen)
        outwards = point.geometric_normal - wp.dot(point.geometric_normal, along) * along
        offset = wp.dot(outwards, beside)
        offset = offset * offset / wp.max(wp.dot(outwards, outwards) * wp.dot(beside, beside), 1.0e-20)
        if offset >= 1.0 - (1.0 - record.aspect * record.aspect) * share:
            closures[count] = new_closure(wp.static(int(ClosureKind.TRANSPARENT)), w)
            return count + 1
    closures[count] = record
    return count + 1


@op("hair_absorption_of_color", "vn>V")
@wp.func
def hair_absorption_of_color(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Absorption of a fibre among others that look as the colour does: colour, roughness around it (equation 9)."""
    color = vector(data, stack, pc + 1)
    b = number(data, stack, pc + 2)
    fit = 5.969 + b * (-0.215 + b * (2.532 + b * (-10.73 + b * (5.574 + b * 0.245))))
    sigma = wp.vec3(0.0)
    for k in range(3):
        x = wp.log(wp.clamp(color[k], 1.0e-5, 1.0)) / fit
        sigma[k] = x * x
    put_vector(data, stack, pc + 3, sigma)


@op("hair_absorption_of_melanin", "nn>V")
@wp.func
def hair_absorption_of_melanin(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Absorption by melanin: its amount 0..1, the share of pheomelanin (equation 6; d'Eon et al. 2011)."""
    amount = -wp.log(wp.max(1.0 - number(data, stack, pc + 1), 0.0001))
    red = amount * number(data, stack, pc + 2)
    brown = amount - red
    put_vector(data, stack, pc + 3, brown * wp.vec3(0.506, 0.841, 1.653) + red * wp.vec3(0.343, 0.733, 1.924))
