"""Texture coordinates of a point."""

import warp as wp

from ....scene.geometry import transform_point
from ...object_space import world_to_object
from ...op import NodeData, op, put_vector
from ...point import ShadingPoint, is_direction, shifted_barycentric, shifted_position


@wp.func
def object_position(data: NodeData, point: ShadingPoint, shift: int) -> wp.vec3:
    """The point in its object's space, or in the world's; in the world the ray's direction."""
    if is_direction(point):
        return -point.incoming
    if point.instance < 0:
        return shifted_position(point, shift)
    return transform_point(world_to_object(data, point), shifted_position(point, shift))


@op("object_coordinates", "s>V", foldable=False)
@wp.func
def object_coordinates(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The point in its object's space; word 1 is the shift."""
    put_vector(data, stack, pc + 2, object_position(data, point, data.code[pc + 1]))


@op("generated", "s>V", foldable=False)
@wp.func
def generated(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The point in the texture space of its mesh, 0..1 across the mesh's box; word 1 is the shift."""
    first = int(-1)
    if point.instance >= 0 and point.primitive >= 0:
        first = data.inputs.generated_first[point.instance]
    position = wp.vec3(0.0)
    if first >= 0:
        corner = first + 3 * point.primitive
        weight = shifted_barycentric(point, data.code[pc + 1])
        a = data.inputs.generated[corner]
        position = (
            a
            + weight[0] * (data.inputs.generated[corner + 1] - a)
            + weight[1] * (data.inputs.generated[corner + 2] - a)
        )
    else:
        position = object_position(data, point, data.code[pc + 1])
        if point.instance >= 0:
            position = (
                wp.cw_mul(position, data.inputs.texture_scale[point.instance])
                + data.inputs.texture_offset[point.instance]
            )
    put_vector(data, stack, pc + 2, position)


@op("uv", "as>V", foldable=False)
@wp.func
def uv(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """UV coordinates by the active map; 0 where there is none. On a lamp, coordinates across its shape."""
    value = wp.vec3(0.0)
    if point.instance >= 0 and point.primitive < 0:
        value = wp.vec3(1.0 - point.barycentric[0] - point.barycentric[1], point.barycentric[0], 0.0)
    if point.instance >= 0:
        first = data.inputs.uv_first[point.instance]
        if first >= 0:
            corner = first + 3 * point.primitive
            weight = shifted_barycentric(point, data.code[pc + 2])
            a = data.inputs.uvs[corner]
            mixed = a + weight[0] * (data.inputs.uvs[corner + 1] - a) + weight[1] * (data.inputs.uvs[corner + 2] - a)
            value = wp.vec3(mixed[0], mixed[1], 0.0)
    put_vector(data, stack, pc + 3, value)
