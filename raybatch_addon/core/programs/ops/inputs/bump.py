"""Normals of surfaces bent by heights and by maps, and tangents of UV maps."""

from enum import IntEnum

import warp as wp

from ....scene.geometry import transform_vector
from ....shading.bsdf.materials import SURFACE_NORMAL, ClosureRecord, new_closure
from ...object_space import object_to_world
from ...op import NodeData, closure_op, number, op, put_vector, vector
from ...point import ShadingPoint
from ..closures.plain import usable_normal
from .attributes import attribute_value, attribute_width
from .geometry_inputs import object_normal, surface_tangent, world_normal

_TINY = 1e-30


class NormalSpace(IntEnum):
    """Axes of a normal map, an immediate."""

    TANGENT = 0
    OBJECT = 1
    WORLD = 2
    BLENDER_OBJECT = 3  # the second and third axes are reversed
    BLENDER_WORLD = 4


@wp.func
def unit_or(v: wp.vec3, fallback: wp.vec3) -> wp.vec3:
    """`v` at length 1; `fallback` where it has no direction."""
    length = wp.length(v)
    result = fallback
    if length > wp.static(_TINY) and length < wp.inf:
        result = v / length
    return result


@wp.func
def bumped(normal: wp.vec3, step_x: wp.vec3, step_y: wp.vec3, rise_x: float, rise_y: float, strength: float) -> wp.vec3:
    """The normal of a surface raised by a height, which grows by `rise_x` and `rise_y` [m] along the steps [m].

    Blinn, "Simulation of Wrinkled Surfaces" (1978). At `strength` 0 it is `normal`, between 0 and 1 a mixture.
    """
    across_x = wp.cross(step_y, normal)
    across_y = wp.cross(normal, step_x)
    area = wp.dot(step_x, across_x)
    gradient = rise_x * across_x + rise_y * across_y
    bent = unit_or(wp.abs(area) * normal - wp.sign(area) * gradient, normal)
    return unit_or(strength * bent + (1.0 - strength) * normal, normal)


@op("bump", "nnnnnnv>V", foldable=False)
@wp.func
def bump(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Bump mapping.

    Operands: height at the point and one step aside along x and y, distance [m], strength, divisor of the steps,
    normal.
    """
    normal = vector(data, stack, pc + 7)
    value = normal
    here = number(data, stack, pc + 1)
    scale = number(data, stack, pc + 4) * number(data, stack, pc + 6)
    rise_x = scale * (number(data, stack, pc + 2) - here)
    rise_y = scale * (number(data, stack, pc + 3) - here)
    # lengths in units that bring steps near 1, so that no square leaves float32
    length = wp.max(wp.length(point.step_x), wp.length(point.step_y))
    if length > 0.0 and wp.abs(rise_x) < wp.inf and wp.abs(rise_y) < wp.inf:
        strength = wp.max(number(data, stack, pc + 5), 0.0)
        value = bumped(normal, point.step_x / length, point.step_y / length, rise_x / length, rise_y / length, strength)
    put_vector(data, stack, pc + 8, value)


@wp.func
def _of_map(color: wp.vec3) -> wp.vec3:
    return 2.0 * color - wp.vec3(1.0)


@wp.func
def interpolated_object_normal(data: NodeData, point: ShadingPoint, side: float) -> wp.vec3:
    """The front's shading normal in object space, unit.

    It is interpolated in object space, which differs from the world where an object is stretched. `side` is -1 where
    the ray met the back.
    """
    g = data.geometry
    if g.corner_normals.shape[0] > 0:
        first = 3 * (g.mesh_triangle_first[g.instance_mesh[point.instance]] + point.primitive)
        a = g.corner_normals[first]
        b = g.corner_normals[first + 1]
        c = g.corner_normals[first + 2]
        if wp.dot(a, a) > 0.0 and wp.dot(b, b) > 0.0 and wp.dot(c, c) > 0.0:
            m = g.instance_transform[point.instance]
            if m[0, 0] == 1.0 and m[1, 1] == 1.0 and m[2, 2] == 1.0:  # the geometry is in world space
                a = object_normal(data, point, a)
                b = object_normal(data, point, b)
                c = object_normal(data, point, c)
            uv = point.barycentric
            return unit_or((1.0 - uv[0] - uv[1]) * a + uv[0] * b + uv[1] * c, side * point.normal)
    return object_normal(data, point, side * point.normal)


@op("normal_map", "iavn>V", foldable=False)
@wp.func
def normal_map(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Normal map: space, tangents (an attribute), colour, strength."""
    space = data.code[pc + 1]
    value = _of_map(vector(data, stack, pc + 3))
    strength = number(data, stack, pc + 4)
    result = point.normal
    side = 1.0 - 2.0 * float(point.backfacing)
    if space == wp.static(int(NormalSpace.TANGENT)):
        if attribute_width(data, point, data.code[pc + 2]) == 4:
            # the tangent is shorter than 1 between corners: maps are made for such tangents
            t = attribute_value(data, point, data.code[pc + 2], 4, point.barycentric)
            tangent = wp.vec3(t[0], t[1], t[2])
            normal = interpolated_object_normal(data, point, side)
            bitangent = wp.sign(t[3]) * wp.cross(normal, tangent)
            depth = 1.0 + (value[2] - 1.0) * wp.clamp(strength, 0.0, 1.0)
            bent = strength * value[0] * tangent + strength * value[1] * bitangent + depth * normal
            length = wp.length(bent)
            if length > wp.static(_TINY) and length < wp.inf:
                result = unit_or(side * world_normal(data, point, bent / length), point.normal)
    else:
        if space >= wp.static(int(NormalSpace.BLENDER_OBJECT)):
            value = wp.vec3(value[0], -value[1], -value[2])
        if space == wp.static(int(NormalSpace.OBJECT)) or space == wp.static(int(NormalSpace.BLENDER_OBJECT)):
            value = world_normal(data, point, value)
        else:
            value = unit_or(value, wp.vec3(0.0))
        value = side * value
        if strength != 1.0:
            value = unit_or(point.normal + wp.max(strength, 0.0) * (value - point.normal), wp.vec3(0.0))
        result = unit_or(value, point.normal)
    put_vector(data, stack, pc + 5, result)


@op("uv_tangent", "a>V", foldable=False)
@wp.func
def uv_tangent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Tangent along the first axis of a UV map; 0 where there is no map."""
    value = wp.vec3(0.0)
    if attribute_width(data, point, data.code[pc + 1]) == 4:
        t = attribute_value(data, point, data.code[pc + 1], 4, point.barycentric)
        value = surface_tangent(data, point, wp.vec3(t[0], t[1], t[2]))
    put_vector(data, stack, pc + 2, value)


@op("displacement", "iv>V", foldable=False)
@wp.func
def displacement(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Displacement of the surface by a height of 1 along a normal [m], in the world (word 1: 0) or object space (1)."""
    value = vector(data, stack, pc + 2)
    if data.code[pc + 1] == 1 and point.instance >= 0:
        value = transform_vector(object_to_world(data, point), object_normal(data, point, value))
    put_vector(data, stack, pc + 3, value)


@closure_op("surface_normal", "v", foldable=False)
@wp.func
def surface_normal(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Normal that all closures of the surface are about.

    It comes first in a program, and its record is no closure.
    """
    normal = usable_normal(vector(data, stack, pc + 1))
    if count >= closures.shape[0] or wp.dot(normal, normal) == 0.0:
        return count
    closures[count] = new_closure(wp.static(SURFACE_NORMAL), wp.vec3(0.0))
    closures[count].normal = normal
    return count + 1
