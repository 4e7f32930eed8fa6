"""Ops that make closures of facets.

A normal of 0 stands for the surface's normal, a tangent of 0 for isotropic facets.
"""

from enum import IntEnum

import warp as wp

from ....scene.description import ClosureKind
from ....shading.bsdf.ggx import is_specular
from ....shading.bsdf.materials import ASPECT_LEAST, FILM_IOR_LEAST, IOR_RANGE, ClosureRecord, new_closure
from ....shading.bsdf.thin_film import FILM_LEAST
from ...op import NodeData, closure_op, number, vector
from ...point import ShadingPoint
from .plain import begins, unit_color, unit_number, usable_index, usable_normal, usable_weight


class Distribution(IntEnum):
    """Distribution of the facets' normals, an immediate of these ops."""

    GGX = 0
    MULTI_GGX = 1  # GGX, with light that bounces more than once between facets
    BECKMANN = 2


_IOR_LEAST = IOR_RANGE[0]
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
    """A record of isotropic facets."""
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
    """`aspect` between its least value and the inverse of that; 1 for NaN."""
    result = float(1.0)
    if aspect > 0.0 and aspect < wp.inf:
        result = wp.clamp(aspect, wp.static(ASPECT_LEAST), wp.static(1.0 / ASPECT_LEAST))
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
def turned_facets(
    data: NodeData, stack: wp.array(dtype=float), kind: int, weight: wp.vec3, first: int, aspect: int
) -> ClosureRecord:
    """A record of facets read from words of an instruction.

    Distribution and roughness are the words from `first` on; aspect, tangent and normal those from `aspect` on.
    """
    record = facet_closure(
        kind, weight, data.code[first], number(data, stack, first + 1), vector(data, stack, aspect + 2)
    )
    record.aspect = usable_aspect(number(data, stack, aspect))
    record.tangent = usable_normal(vector(data, stack, aspect + 1))
    return record


@wp.func
def filmed_facets(
    data: NodeData, stack: wp.array(dtype=float), kind: int, weight: wp.vec3, first: int, aspect: int
) -> ClosureRecord:
    """A record of facets with a film; words as in `turned_facets`, then the film's thickness [nm] and index."""
    record = turned_facets(data, stack, kind, weight, first, aspect)
    record.film_thickness = film_thickness(data, stack, aspect + 3)
    record.film_ior = usable_index(number(data, stack, aspect + 4), wp.static(FILM_IOR_LEAST))
    return record


@closure_op("glossy", "vvinnvv")
@wp.func
def glossy(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Facets that reflect all light: weight, colour, distribution, roughness, aspect, tangent, normal.

    The weight contains the colour.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = turned_facets(data, stack, _GLOSSY, weight, pc + 3, pc + 5)
    record.color = usable_weight(vector(data, stack, pc + 2))
    closures[count] = record
    return count + 1


@closure_op("ashikhmin_shirley", "vnnvv")
@wp.func
def ashikhmin_shirley(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Phong lobe: weight, roughness, aspect, tangent, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = facet_closure(_ASHIKHMIN_SHIRLEY, weight, 0, number(data, stack, pc + 2), vector(data, stack, pc + 5))
    record.aspect = usable_aspect(number(data, stack, pc + 3))
    record.tangent = usable_normal(vector(data, stack, pc + 4))
    closures[count] = record
    return count + 1


@closure_op("metal", "vvvinnvvnn")
@wp.func
def metal(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Metal with the Fresnel of F82-tint.

    Operands: weight (without colour), reflectance at normal incidence, tint at 82 degrees, distribution, roughness,
    aspect, tangent, normal, film's thickness [nm] and index.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = filmed_facets(data, stack, _METAL, weight, pc + 4, pc + 6)
    record.color = unit_color(vector(data, stack, pc + 2))
    record.edge = unit_color(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("conductor", "vvvinnvvnn")
@wp.func
def conductor(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Metal with the Fresnel of a conductor.

    Operands: weight, index of refraction, extinction coefficient, distribution, roughness, aspect, tangent, normal,
    film's thickness [nm] and index.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = filmed_facets(data, stack, _CONDUCTOR, weight, pc + 4, pc + 6)
    record.color = usable_weight(vector(data, stack, pc + 2))
    record.edge = usable_weight(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("dielectric", "vvinnnvvnn")
@wp.func
def dielectric(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Reflection of a dielectric.

    Operands: weight, tint at normal incidence, distribution, roughness, index, aspect, tangent, normal, film's
    thickness [nm] and index.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    ior = usable_index(number(data, stack, pc + 5), wp.static(_IOR_LEAST))
    film = film_thickness(data, stack, pc + 9)
    if not begins(weight, closures, count) or (ior == 1.0 and film <= wp.static(FILM_LEAST)):
        return count
    record = filmed_facets(data, stack, _DIELECTRIC, weight, pc + 3, pc + 6)
    record.ior = ior
    record.edge = usable_weight(vector(data, stack, pc + 2))
    closures[count] = record
    return count + 1


@closure_op("layered_diffuse", "vinnv")
@wp.func
def layered_diffuse(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Lambert's law below a dielectric: weight, distribution, roughness, index, normal.

    It gets the light that `dielectric` of the same distribution, roughness and index does not reflect.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = facet_closure(
        _LAYERED_DIFFUSE, weight, data.code[pc + 2], number(data, stack, pc + 3), vector(data, stack, pc + 5)
    )
    record.ior = usable_index(number(data, stack, pc + 4), wp.static(_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("glass", "vvvvinnvnn")
@wp.func
def glass(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Glass, which reflects and refracts.

    Operands: weight, refracted light relative to it, colour of bounces between facets, tint of the reflection at normal
    incidence, distribution, roughness, index, normal, film's thickness [nm] and index.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = facet_closure(_GLASS, weight, data.code[pc + 5], number(data, stack, pc + 6), vector(data, stack, pc + 8))
    record.refraction = usable_weight(vector(data, stack, pc + 2))
    record.color = usable_weight(vector(data, stack, pc + 3))
    record.edge = usable_weight(vector(data, stack, pc + 4))
    record.ior = usable_index(number(data, stack, pc + 7), wp.static(_IOR_LEAST))
    record.film_thickness = film_thickness(data, stack, pc + 9)
    record.film_ior = usable_index(number(data, stack, pc + 10), wp.static(FILM_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("refraction", "vinnv")
@wp.func
def refraction(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Facets that refract all light: weight, distribution, roughness, index, normal."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    record = facet_closure(
        _REFRACTION, weight, data.code[pc + 2], number(data, stack, pc + 3), vector(data, stack, pc + 5)
    )
    record.ior = usable_index(number(data, stack, pc + 4), wp.static(_IOR_LEAST))
    closures[count] = record
    return count + 1


@closure_op("sheet", "vnnv")
@wp.func
def sheet(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Transmission of a sheet without thickness: weight, roughness and index of the sheet's surfaces, normal.

    Light is refracted twice, to a lobe about straight on (Kulla and Conty, "Revisiting Physically Based Shading at
    Imageworks", 2017, page 40). A smooth sheet, and one of an index of at most 1, is transparent.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    roughness = unit_number(number(data, stack, pc + 2))
    eta = usable_index(number(data, stack, pc + 3), 1.0)
    alpha = wp.min(roughness * roughness * wp.sqrt(3.4 * (1.0 - 1.0 / eta)) * (1.0 - 0.5 / eta), 1.0)
    if is_specular(alpha):
        closures[count] = new_closure(_TRANSPARENT, weight)
        return count + 1
    record = facet_closure(
        _SHEET, weight, wp.static(int(Distribution.MULTI_GGX)), wp.sqrt(alpha), vector(data, stack, pc + 4)
    )
    closures[count] = record
    return count + 1
