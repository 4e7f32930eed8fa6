"""Ops that make rough diffuse closures, cloth, and media below surfaces."""

import math
from enum import IntEnum

import warp as wp

from ....scene.description import ClosureKind
from ....shading.bsdf.materials import ClosureRecord, new_closure
from ....shading.bsdf.subsurface import dipole_albedo, fitted_albedo, lifted_albedo, medium_albedo
from ...op import NodeData, closure_op, number, vector
from ...point import ShadingPoint
from .plain import begins, is_black, unit_color, unit_number, usable_index, usable_normal, usable_weight


class SubsurfaceMethod(IntEnum):
    """How a medium follows from a colour and a radius."""

    RANDOM_WALK = 0  # the radius is the mean free path
    SKIN = 1  # the radius is scaled by that of a dipole of the colour, and half of the light goes in diffusely
    LEGACY = 2  # the radius is 4 pi mean free paths


# Light of a smaller radius does not scatter below the surface [m]
_RADIUS_LEAST = 1e-8
# Grooves of a smaller roughness count as none
_ROUGHNESS_LEAST = 1e-5


@wp.func
def _soft_closure(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    kind: int,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    w = usable_weight(vector(data, stack, pc + 1))
    if not begins(w, closures, count):
        return count
    record = new_closure(kind, w)
    record.roughness = unit_number(number(data, stack, pc + 2))
    record.normal = usable_normal(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("rough_diffuse", "vvnv")
@wp.func
def rough_diffuse(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Oren and Nayar's reflection: weight, colour of bounces between grooves, roughness, normal.

    Without roughness it is Lambert's law.
    """
    weight = usable_weight(vector(data, stack, pc + 1))
    if not begins(weight, closures, count):
        return count
    roughness = unit_number(number(data, stack, pc + 3))
    record = new_closure(wp.static(int(ClosureKind.ROUGH_DIFFUSE)), weight)
    record.color = unit_color(vector(data, stack, pc + 2))
    record.roughness = roughness
    record.normal = usable_normal(vector(data, stack, pc + 4))
    if roughness < wp.static(_ROUGHNESS_LEAST):
        record.kind = wp.static(int(ClosureKind.DIFFUSE))
    closures[count] = record
    return count + 1


@closure_op("sheen", "vnv")
@wp.func
def sheen(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """A layer of fibres: weight, roughness, normal."""
    return _soft_closure(data, stack, pc, wp.static(int(ClosureKind.SHEEN)), closures, count)


@closure_op("velvet", "vnv")
@wp.func
def velvet(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Ashikhmin's velvet: weight, sigma, normal."""
    return _soft_closure(data, stack, pc, wp.static(int(ClosureKind.VELVET)), closures, count)


@closure_op("toon", "vinnv")
@wp.func
def toon(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """A cone of light: weight, whether it mirrors (1), size, width of its edge, normal."""
    w = usable_weight(vector(data, stack, pc + 1))
    if not begins(w, closures, count):
        return count
    record = new_closure(wp.static(int(ClosureKind.TOON)), w)
    record.distribution = data.code[pc + 2]
    record.roughness = unit_number(number(data, stack, pc + 3))
    record.mean_cosine = unit_number(number(data, stack, pc + 4))
    record.normal = usable_normal(vector(data, stack, pc + 5))
    closures[count] = record
    return count + 1


@closure_op("subsurface", "vvvninnv", most=2)
@wp.func
def subsurface(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Light that scatters below the surface.

    Operands: weight (without colour), colour, radius by channel [m], mean cosine of scattering, `SubsurfaceMethod`,
    roughness and index of the surface where light goes in, normal. Channels of hardly any radius are Lambertian.
    """
    color = unit_color(vector(data, stack, pc + 2))
    weight = wp.cw_mul(usable_weight(vector(data, stack, pc + 1)), color)
    if not begins(weight, closures, count):
        return count
    radius = usable_weight(vector(data, stack, pc + 3))
    method = data.code[pc + 5]
    ior = wp.clamp(usable_index(number(data, stack, pc + 7), 1.0), 1.01, 3.8)
    most = float(0.99)
    if method != wp.static(int(SubsurfaceMethod.RANDOM_WALK)):
        most = 0.9
    g = number(data, stack, pc + 4)
    g = wp.clamp(wp.where(g == g, g, 0.0), -0.99, most)
    record = new_closure(wp.static(int(ClosureKind.SUBSURFACE)), weight)
    record.roughness = unit_number(number(data, stack, pc + 6))
    record.ior = ior
    record.mean_cosine = g
    record.normal = usable_normal(vector(data, stack, pc + 8))
    if method == wp.static(int(SubsurfaceMethod.SKIN)):
        record.multiscatter = 1
        record.roughness = 1.0
    flat = wp.vec3(0.0)
    for i in range(3):
        c = color[i]
        free = radius[i]
        if free < wp.static(_RADIUS_LEAST):
            flat[i] = weight[i]
            record.weight[i] = 0.0
            free = wp.static(_RADIUS_LEAST)
            c = 0.0
        if method == wp.static(int(SubsurfaceMethod.SKIN)):
            free = free * wp.sqrt(3.0 * (1.0 - dipole_albedo(c, ior)))
        if method == wp.static(int(SubsurfaceMethod.LEGACY)):
            free = free * wp.static(0.25 / math.pi)
        albedo = medium_albedo(c, g)
        extinction = 1.0 / free
        if method != wp.static(int(SubsurfaceMethod.RANDOM_WALK)) and g >= 0.0:
            albedo = fitted_albedo(c, g)
            extinction = extinction / (1.0 - g)
        lifted = lifted_albedo(albedo)
        record.color[i] = lifted[0]
        record.edge[i] = extinction
        record.refraction[i] = 0.0
        if c > 0.0:
            record.refraction[i] = lifted[1] / c
    if not is_black(record.weight):
        closures[count] = record
        count += 1
    if begins(flat, closures, count):
        lambertian = new_closure(wp.static(int(ClosureKind.DIFFUSE)), flat)
        lambertian.normal = record.normal
        closures[count] = lambertian
        count += 1
    return count
