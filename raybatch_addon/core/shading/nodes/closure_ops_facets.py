"""Ops that make closures of facets. Normals and tangents may be 0: the surface's normal, and facets that are alike in all directions."""

from enum import IntEnum

import warp as wp

from ...scene.description import ClosureKind
from ..film import FILM_LEAST
from ..materials import IOR_RANGE, ClosureRecord, new_closure
from ..microfacet import is_specular
from .closure_ops import is_black, unit_color, unit_number, usable_index, usable_normal, usable_weight
from .op import NodeData, closure_op, number, vector
from .point import ShadingPoint


class Distribution(IntEnum):
    """How facets are turned: an immediate of these ops."""

    GGX = 0
    MULTI_GGX = 1  # with what bounces more than once between facets
    BECKMANN = 2


_IOR_LEAST = IOR_RANGE[0]
_ASPECT_LEAST = 1e-4
FILM_IOR_LEAST = 1e-5
_GLOSSY = wp.constant(int(ClosureKind.GLOSSY))
_METAL = wp.constant(int(ClosureKind.METAL))
_DIELECTRIC = wp.constant(int(ClosureKind.DIELECTRIC))
_GLASS = wp.constant(int(ClosureKind.GLASS))
_REFRACTION = wp.constant(int(ClosureKind.REFRACTION))
_CONDUCTOR = wp.constant(int(ClosureKind.CONDUCTOR))
_ASHIKHMIN_SHIRLEY = wp.constant(int(ClosureKind.ASHIKHMIN_SHIRLEY))
_SHEET = wp.constant(int(ClosureKind.SHEET))
_TRANSPARENT = wp.constant(int(ClosureKind.TRANSPARENT))
_LAYERED_DIFFUSE = wp.constant(int(ClosureKind.LAYERED_DIFFUSE))


@wp.func
def facet_closure(kind: int, weight: wp.vec3, distribution: int, roughness: float, normal: wp.vec3) -> ClosureRecord:
    """A record of facets that are alike in all directions."""
    record = new_closure(kind, weight)
    if distribution == wp.static(int(Distribution.MULTI_GGX)):
        record.multiscatter = 1
    if distribution == wp.static(int(Distribution.BECKMANN)):
        record.distribution = 1
    record.roughness = unit_number(roughness)
    record.normal = usable_normal(normal)
    return record


@wp.func
def usable_aspect(aspect: float) -> float:
    """`aspect` between its least and the inverse of that; 1 where it is no number."""
    result = float(1.0)
    if aspect > 0.0 and aspect < wp.inf:
        result = wp.clamp(aspect, wp.static(_ASPECT_LEAST), wp.static(1.0 / _ASPECT_LEAST))
    return result


@wp.func
def film_thickness(data: NodeData, stack: wp.array(dtype=float), at: int) -> float:
    """The thickness [nm] whose word is at `at`, at least 0."""
    thickness = number(data, stack, at)
    result = float(0.0)
    if thickness > 0.0:
        result = wp.min(thickness, 1.0e9)
    return result


@wp.func
def turned_facets(data: NodeData, stack: wp.array(dtype=float), kind: int, weight: wp.vec3, first: int, aspect: int) -> ClosureRecord:
    """A record of facets: distribution and roughness are the words from `first` on; aspect, tangent and normal those from `aspect` on."""
    record = facet_closure(kind, weight, data.code[first], number(data, stack, first + 1), vector(data, stack, aspect + 2))
    record.aspect = usable_aspect(number(data, stack, aspect))
    record.tangent = usable_normal(vector(data, stack, aspect + 1))
    return record


@wp.func
def filmed_facets(data: NodeData, stack: wp.array(dtype=float), kind: int, weight: wp.vec3, first: int, aspect: int) -> ClosureRecord:
    """The same with a film, whose thickness [nm] and index follow the normal."""
    record = turned_facets(data, stack, kind, weight, first, aspect)
    record.film_thickness = film_thickness(data, stack, aspect + 3)
    record.film_ior = usable_index(number(data, stack, aspect + 4), wp.static(FILM_IOR_LEAST))
    return record


@closure_op("glossy", "vvinnvv")
@wp.func
def glossy(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Reflects all light: weight, colour (which the weight contains), distribution, roughness, aspect, tangent, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = turned_facets(data, stack, _GLOSSY, weight, pc + 3, pc + 5)
    record.colour = usable_weight(vector(data, stack, pc + 2))
    closures[count] = record
    return count + 1


@closure_op("ashikhmin_shirley", "vnnvv")
@wp.func
def ashikhmin_shirley(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """A Phong lobe: weight, roughness, aspect, tangent, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = facet_closure(_ASHIKHMIN_SHIRLEY, weight, 0, number(data, stack, pc + 2), vector(data, stack, pc + 5))
    record.aspect = usable_aspect(number(data, stack, pc + 3))
    record.tangent = usable_normal(vector(data, stack, pc + 4))
    closures[count] = record
    return count + 1


@closure_op("metal", "vvvinnvvnn")
@wp.func
def metal(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """F82-tint: weight (without colour), reflectance at normal incidence, tint at 82 degrees, distribution, roughness, aspect, tangent,
    normal, film's thickness [nm] and index."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = filmed_facets(data, stack, _METAL, weight, pc + 4, pc + 6)
    record.colour = unit_color(vector(data, stack, pc + 2))
    record.edge = unit_color(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("conductor", "vvvinnvvnn")
@wp.func
def conductor(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """A metal by its indices: weight, index of refraction, extinction coefficient, distribution, roughness, aspect, tangent, normal, film's
    thickness [nm] and index."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = filmed_facets(data, stack, _CONDUCTOR, weight, pc + 4, pc + 6)
    record.colour = usable_weight(vector(data, stack, pc + 2))
    record.edge = usable_weight(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("dielectric", "vvinnnvvnn")
@wp.func
def dielectric(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """What a dielectric reflects: weight, tint at normal incidence, distribution, roughness, index, aspect, tangent, normal, film's
    thickness [nm] and index."""
    weight = usable_weight(vector(data, stack, pc + 1))
    ior = usable_index(number(data, stack, pc + 5), wp.static(_IOR_LEAST))
    film = film_thickness(data, stack, pc + 9)
    if is_black(weight) or (ior == 1.0 and film <= wp.static(FILM_LEAST)) or count >= closures.shape[0]:
        return count
    record = filmed_facets(data, stack, _DIELECTRIC, weight, pc + 3, pc + 6)
    record.ior = ior
    record.edge = usable_weight(vector(data, stack, pc + 2))
    closures[count] = record
    return count + 1


@closure_op("layered_diffuse", "vinnv")
@wp.func
def layered_diffuse(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Lambert's law below what `dielectric` reflects of the same distribution, roughness and index: weight, these, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = facet_closure(_LAYERED_DIFFUSE, weight, data.code[pc + 2], number(data, stack, pc + 3), vector(data, stack, pc + 5))
    record.ior = usable_index(number(data, stack, pc + 4), wp.static(_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("glass", "vvvvinnvnn")
@wp.func
def glass(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Reflects and refracts: weight, what refracts relative to it, colour of bounces between facets, tint of what is reflected at normal
    incidence, distribution, roughness, index, normal, film's thickness [nm] and index."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = facet_closure(_GLASS, weight, data.code[pc + 5], number(data, stack, pc + 6), vector(data, stack, pc + 8))
    record.refraction = usable_weight(vector(data, stack, pc + 2))
    record.colour = usable_weight(vector(data, stack, pc + 3))
    record.edge = usable_weight(vector(data, stack, pc + 4))
    record.ior = usable_index(number(data, stack, pc + 7), wp.static(_IOR_LEAST))
    record.film_thickness = film_thickness(data, stack, pc + 9)
    record.film_ior = usable_index(number(data, stack, pc + 10), wp.static(FILM_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("refraction", "vinnv")
@wp.func
def refraction(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Refracts all light: weight, distribution, roughness, index, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = facet_closure(_REFRACTION, weight, data.code[pc + 2], number(data, stack, pc + 3), vector(data, stack, pc + 5))
    record.ior = usable_index(number(data, stack, pc + 4), wp.static(_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("sheet", "vnnv")
@wp.func
def sheet(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Light that a sheet without thickness lets through: weight, roughness and index of the sheet's surfaces, normal.

    It is refracted twice, to a lobe about straight on (Kulla and Conty, "Revisiting Physically Based Shading at Imageworks", 2017, page
    40). A smooth sheet, and one of an index of at most 1, is transparent.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    roughness = unit_number(number(data, stack, pc + 2))
    eta = usable_index(number(data, stack, pc + 3), 1.0)
    alpha = wp.min(roughness * roughness * wp.sqrt(3.4 * (1.0 - 1.0 / eta)) * (1.0 - 0.5 / eta), 1.0)
    if is_specular(alpha):
        closures[count] = new_closure(_TRANSPARENT, weight)
        return count + 1
    record = facet_closure(_SHEET, weight, wp.static(int(Distribution.MULTI_GGX)), wp.sqrt(alpha), vector(data, stack, pc + 4))
    closures[count] = record
    return count + 1
