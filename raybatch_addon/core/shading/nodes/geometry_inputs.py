"""What is known of the point itself: Geometry, the other Texture Coordinates, Camera Data, Wireframe."""

import warp as wp

from ...scene.geometry import transform_point, triangle_vertices
from .coordinates import object_position
from .op import NodeData, number, op, put_number, put_vector
from .point import ShadingPoint, shifted_barycentric, shifted_position
from .spaces import transposed_vector


@wp.func
def object_normal(data: NodeData, point: ShadingPoint, normal: wp.vec3) -> wp.vec3:
    """A normal of the world in object space, unit; of the world itself as it is."""
    if point.instance < 0:
        return normal
    # normals go from the object to the world by the transposed inverse; backwards by the transpose of the map itself
    return wp.normalize(transposed_vector(data.inputs.to_world[point.instance], normal))


@wp.func
def world_normal(data: NodeData, point: ShadingPoint, normal: wp.vec3) -> wp.vec3:
    """A normal of the object in world space, unit."""
    if point.instance < 0:
        return normal
    return wp.normalize(transposed_vector(data.inputs.to_object[point.instance], normal))


@op("position", "i>V", foldable=False)
@wp.func
def position(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """In the world; word 1 is the shift. Of a world the direction that is looked in."""
    value = shifted_position(point, data.code[pc + 1])
    if point.instance < 0:
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
    """The direction towards the viewer, mirrored by the normal; of a world the direction that is looked in."""
    value = 2.0 * wp.dot(point.normal, point.incoming) * point.normal - point.incoming
    if point.instance < 0:
        value = -point.incoming
    put_vector(data, stack, pc + 1, value)


@op("parametric", "i>V", foldable=False)
@wp.func
def parametric(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Weights of the triangle's first and second corner; word 1 is the shift."""
    uv = shifted_barycentric(point, data.code[pc + 1])
    put_vector(data, stack, pc + 2, wp.vec3(1.0 - uv[0] - uv[1], uv[0], 0.0))


@op("backfacing", ">N", foldable=False)
@wp.func
def backfacing(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """1 on the back of a surface."""
    put_number(data, stack, pc + 1, float(point.backfacing))


@wp.func
def surface_tangent(data: NodeData, point: ShadingPoint, direction: wp.vec3) -> wp.vec3:
    """The tangent that follows `direction`, of object space, on the surface; as in Cycles it goes to the world as normals do."""
    along = world_normal(data, point, direction)
    across = wp.cross(along, point.normal)
    if wp.dot(across, across) == 0.0:
        return wp.vec3(0.0)
    return wp.cross(point.normal, wp.normalize(across))


@op("radial_tangent", "ii>V", foldable=False)
@wp.func
def radial_tangent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Around the axis X, Y or Z (word 1: 0, 1, 2) through the middle of the texture space; word 2 is the shift."""
    generated = object_position(data, point, data.code[pc + 2])
    if point.instance >= 0 and point.primitive < 0:
        generated = point.position  # of a lamp that in the world, as in Cycles
    elif point.instance >= 0:
        generated = wp.cw_mul(generated, data.inputs.texture_scale[point.instance]) + data.inputs.texture_offset[point.instance]
    from_axis = generated - wp.vec3(0.5)
    axis = data.code[pc + 1]
    around = wp.vec3(-from_axis[1], from_axis[0], 0.0)
    if axis == 0:
        around = wp.vec3(0.0, -from_axis[2], from_axis[1])
    elif axis == 1:
        around = wp.vec3(-from_axis[2], 0.0, from_axis[0])
    put_vector(data, stack, pc + 3, surface_tangent(data, point, around))


@op("camera_coordinates", "i>VNNV", foldable=False)
@wp.func
def camera_coordinates(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Direction from the camera in its own axes (+Z ahead), depth along its axis, distance, point in those axes; word 1 is the shift."""
    place = shifted_position(point, data.code[pc + 1])
    if point.instance < 0:
        place = data.inputs.camera_position - point.incoming
    p = transform_point(data.inputs.to_camera, place)
    put_vector(data, stack, pc + 2, wp.normalize(p))
    put_number(data, stack, pc + 3, p[2])
    put_number(data, stack, pc + 4, wp.length(p))
    put_vector(data, stack, pc + 5, p)


@op("window_coordinates", "i>V", foldable=False)
@wp.func
def window_coordinates(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Where the point is seen in the frame, 0..1; word 1 is the shift."""
    place = shifted_position(point, data.code[pc + 1])
    if point.instance < 0:
        place = data.inputs.camera_position - point.incoming
    p = transform_point(data.inputs.to_camera, place)
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
    """Width of a pixel as far away as the ray has come [m]."""
    width = data.inputs.pixel_width
    if data.inputs.perspective != 0:
        width = width * point.ray_length
    return width


@wp.func
def footprint_axis(n: wp.vec3) -> wp.vec3:
    """The first of two unit axes across the unit vector `n` along which Blender compares what is beside a point; the second is n x this."""
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
    """1 nearer to an edge of the triangle than half the size: in metres (word 1: 0), or in pixels (1)."""
    found = float(0.0)
    if point.instance >= 0 and point.primitive >= 0:
        half = 0.5 * number(data, stack, pc + 2)
        if data.code[pc + 1] != 0:
            axis = footprint_axis(point.geometric_normal)
            other = wp.cross(point.geometric_normal, axis)
            half = half * pixel_footprint(data, point) * 0.5 * (_seen_length(axis, point.incoming) + _seen_length(other, point.incoming))
        a, b, c = triangle_vertices(data.geometry, point.instance, point.primitive)
        if _distance(a, b, point.position) < half or _distance(b, c, point.position) < half or _distance(c, a, point.position) < half:
            found = 1.0
    put_number(data, stack, pc + 3, found)


@wp.func
def _distance(a: wp.vec3, b: wp.vec3, p: wp.vec3) -> float:
    """From `p` to the line through `a` and `b` [m]."""
    edge = b - a
    length = wp.length(edge)
    if length == 0.0:
        return wp.length(p - a)
    return wp.length(wp.cross(edge, p - a)) / length
