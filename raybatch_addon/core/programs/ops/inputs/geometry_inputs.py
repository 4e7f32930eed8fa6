"""Inputs from the point itself: Geometry, the other Texture Coordinates, Camera Data, Wireframe."""

import warp as wp

from ....scene.geometry import transform_point
from ....scene.moved import triangle_vertices_at
from ...object_space import object_to_world, world_to_object
from ...op import NodeData, number, op, put_number, put_vector
from ...point import ShadingPoint, is_direction, shifted_barycentric, shifted_position
from ..values.spaces import transposed_vector
from .coordinates import object_position


@wp.func
def object_normal(data: NodeData, point: ShadingPoint, normal: wp.vec3) -> wp.vec3:
    """A normal of the world in object space, unit; unchanged where there is no object."""
    if point.instance < 0:
        return normal
    # normals go from the object to the world by the transposed inverse, and back by the transposed map
    return wp.normalize(transposed_vector(object_to_world(data, point), normal))


@wp.func
def world_normal(data: NodeData, point: ShadingPoint, normal: wp.vec3) -> wp.vec3:
    """A normal of the object in world space, unit."""
    if point.instance < 0:
        return normal
    return wp.normalize(transposed_vector(world_to_object(data, point), normal))


@op("position", "s>V", foldable=False)
@wp.func
def position(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Position in the world [m]; word 1 is the shift. In the world shader it is the ray's direction."""
    value = shifted_position(point, data.code[pc + 1])
    if is_direction(point):
        value = -point.incoming
    put_vector(data, stack, pc + 2, value)


@op("normals", ">VVV", foldable=False)
@wp.func
def normals(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The shading normal, the triangle's, and the direction towards the viewer."""
    put_vector(data, stack, pc + 1, point.normal)
    put_vector(data, stack, pc + 2, point.geometric_normal)
    put_vector(data, stack, pc + 3, point.incoming)


@op("object_normal", ">V", foldable=False)
@wp.func
def object_normal_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The shading normal in object space."""
    put_vector(data, stack, pc + 1, object_normal(data, point, point.normal))


@op("reflection", ">V", foldable=False)
@wp.func
def reflection(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The direction towards the viewer, mirrored by the normal; in the world shader the ray's direction."""
    value = 2.0 * wp.dot(point.normal, point.incoming) * point.normal - point.incoming
    if point.instance < 0:
        value = -point.incoming
    put_vector(data, stack, pc + 1, value)


@op("parametric", "s>V", foldable=False)
@wp.func
def parametric(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Weights of the triangle's first and second corner; word 1 is the shift."""
    uv = shifted_barycentric(point, data.code[pc + 1])
    put_vector(data, stack, pc + 2, wp.vec3(1.0 - uv[0] - uv[1], uv[0], 0.0))


@op("backfacing", ">N", foldable=False)
@wp.func
def backfacing(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """1 on the back of a surface, else 0."""
    put_number(data, stack, pc + 1, float(point.backfacing))


@wp.func
def surface_tangent(data: NodeData, point: ShadingPoint, direction: wp.vec3) -> wp.vec3:
    """The tangent of the surface that follows `direction`, of object space.

    As in Cycles it goes to the world as normals do.
    """
    along = world_normal(data, point, direction)
    across = wp.cross(along, point.normal)
    if wp.dot(across, across) == 0.0:
        return wp.vec3(0.0)
    return wp.cross(point.normal, wp.normalize(across))


@op("radial_tangent", "is>V", foldable=False)
@wp.func
def radial_tangent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Tangent around an axis through the middle of the texture space.

    Word 1 is the axis (0, 1, 2: X, Y, Z), word 2 the shift.
    """
    generated = object_position(data, point, data.code[pc + 2])
    if point.instance >= 0 and point.primitive < 0:
        generated = point.position  # a lamp has the position in the world, as in Cycles
    elif point.instance >= 0:
        generated = (
            wp.cw_mul(generated, data.inputs.texture_scale[point.instance]) + data.inputs.texture_offset[point.instance]
        )
    from_axis = generated - wp.vec3(0.5)
    axis = data.code[pc + 1]
    around = wp.vec3(-from_axis[1], from_axis[0], 0.0)
    if axis == 0:
        around = wp.vec3(0.0, -from_axis[2], from_axis[1])
    elif axis == 1:
        around = wp.vec3(-from_axis[2], 0.0, from_axis[0])
    put_vector(data, stack, pc + 3, surface_tangent(data, point, around))


@op("camera_coordinates", "s>VNNV", foldable=False)
@wp.func
def camera_coordinates(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Camera coordinates; word 1 is the shift.

    They are: direction from the camera in its own axes (+Z ahead), depth along its axis [m], distance [m], point in
    those axes [m].
    """
    world_point = shifted_position(point, data.code[pc + 1])
    if is_direction(point):
        world_point = data.inputs.camera_position - point.incoming
    p = transform_point(data.inputs.to_camera, world_point)
    put_vector(data, stack, pc + 2, wp.normalize(p))
    put_number(data, stack, pc + 3, p[2])
    put_number(data, stack, pc + 4, wp.length(p))
    put_vector(data, stack, pc + 5, p)


@op("window_coordinates", "s>V", foldable=False)
@wp.func
def window_coordinates(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Position of the point in the frame, 0..1; word 1 is the shift."""
    world_point = shifted_position(point, data.code[pc + 1])
    if is_direction(point):
        world_point = data.inputs.camera_position - point.incoming
    p = transform_point(data.inputs.to_camera, world_point)
    x, y = p[0], p[1]
    if data.inputs.perspective != 0:
        depth = p[2]
        if depth == 0.0:
            depth = 1.0
        x = x / depth
        y = y / depth
    w = data.inputs.window
    put_vector(data, stack, pc + 2, wp.vec3((x - w[0]) / (w[1] - w[0]), (y - w[2]) / (w[3] - w[2]), 0.0))


@wp.func
def pixel_footprint(data: NodeData, point: ShadingPoint) -> float:
    """Width of a pixel at the larger of two distances [m]: that from the camera, and the length of the last ray, which
    begins at the near plane or where the path scattered. The way of a path that was bent is longer than either.
    """
    width = data.inputs.pixel_width
    if data.inputs.perspective != 0:
        width = width * wp.max(point.ray_length, wp.length(point.position - data.inputs.camera_position))
    return width


@wp.func
def footprint_axis(n: wp.vec3) -> wp.vec3:
    """The first of two unit axes across unit `n`, along which Blender compares the surroundings of a point.

    The second axis is n x this.
    """
    axis = wp.vec3(n[2] - n[1], n[0] - n[2], n[1] - n[0])
    if n[0] == n[1] and n[0] == n[2]:
        axis = wp.vec3(n[2] - n[1], n[0] + n[2], -n[1] - n[0])
    return wp.normalize(axis)


@wp.func
def _seen_length(v: wp.vec3, direction: wp.vec3) -> float:
    return wp.length(v - wp.dot(v, direction) * direction)


@op("wireframe", "in>N", foldable=False)
@wp.func
def wireframe(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """1 within half the size of an edge of the triangle, in metres (word 1: 0) or pixels (1); else 0."""
    found = float(0.0)
    if point.instance >= 0 and point.primitive >= 0:
        half = 0.5 * number(data, stack, pc + 2)
        if data.code[pc + 1] != 0:
            axis = footprint_axis(point.geometric_normal)
            other = wp.cross(point.geometric_normal, axis)
            half = (
                half
                * pixel_footprint(data, point)
                * 0.5
                * (_seen_length(axis, point.incoming) + _seen_length(other, point.incoming))
            )
        a, b, c = triangle_vertices_at(data.geometry, point.instance, point.primitive, point.time)
        if (
            _distance(a, b, point.position) < half
            or _distance(b, c, point.position) < half
            or _distance(c, a, point.position) < half
        ):
            found = 1.0
    put_number(data, stack, pc + 3, found)


@wp.func
def _distance(a: wp.vec3, b: wp.vec3, p: wp.vec3) -> float:
    """Distance from `p` to the line through `a` and `b` [m]."""
    edge = b - a
    length = wp.length(edge)
    if length == 0.0:
        return wp.length(p - a)
    return wp.length(wp.cross(edge, p - a)) / length
