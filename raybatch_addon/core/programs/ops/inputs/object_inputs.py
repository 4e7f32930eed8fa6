"""Inputs from the object of the point: Object Info."""

import warp as wp

from ...object_space import object_to_world
from ...op import NodeData, op, put_number, put_vector
from ...point import ShadingPoint


@op("object_location", ">V", foldable=False)
@wp.func
def object_location(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Position of the object's origin in the world [m]."""
    value = wp.vec3(0.0)
    if point.instance >= 0:
        m = object_to_world(data, point)
        value = wp.vec3(m[0, 3], m[1, 3], m[2, 3])
    put_vector(data, stack, pc + 1, value)


@op("object_info", ">VNNN", foldable=False)
@wp.func
def object_info(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The object's colour, alpha, index and random number."""
    color = wp.vec3(0.0)
    alpha = float(0.0)
    index = float(0.0)
    random = float(0.0)
    if point.instance >= 0 and data.inputs.info.shape[0] > 0:
        i = point.instance
        color = wp.vec3(data.inputs.info[i, 0], data.inputs.info[i, 1], data.inputs.info[i, 2])
        alpha = data.inputs.info[i, 3]
        index = data.inputs.info[i, 4]
        random = data.inputs.info[i, 5]
    put_vector(data, stack, pc + 1, color)
    put_number(data, stack, pc + 2, alpha)
    put_number(data, stack, pc + 3, index)
    put_number(data, stack, pc + 4, random)
