"""Inputs of volumes: where a point is in the world's, and values that an object has at points of space, by name."""

import warp as wp

from ....scene.geometry import mat34, transform_point
from ...object_space import world_to_object
from ...op import NodeData, number, op, put_number, put_vector
from ...point import ShadingPoint, shifted_position

# In the table of attributes of volumes an entry has these numbers: two halves of the address of a `wp.Volume`, and the
# map from object space to its indices
GRID_NUMBERS = 14


@op("volume_position", "s>V", foldable=False)
@wp.func
def volume_position(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The point, also in the world, which to other ops is a direction; word 1 is the shift."""
    put_vector(data, stack, pc + 2, shifted_position(point, data.code[pc + 1]))


@wp.func
def _grid_address(data: NodeData, first: int) -> wp.uint64:
    low = wp.uint64(wp.uint32(wp.cast(data.inputs.attribute_values[first], int)))
    high = wp.uint64(wp.uint32(wp.cast(data.inputs.attribute_values[first + 1], int)))
    return low | (high << wp.uint64(32))


@op("volume_attribute", "an>VNN", foldable=False)
@wp.func
def volume_attribute(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Grid of an object as colour, number and alpha; operand 2 is the value where the object has none of that name."""
    missing = number(data, stack, pc + 2)
    color = wp.vec3(missing)
    alpha = float(0.0)
    which = data.code[pc + 1]
    if point.instance >= 0 and which >= 0 and which < data.inputs.attribute_first.shape[1]:
        row = data.inputs.attribute_row[point.instance]
        first = data.inputs.attribute_first[row, which]
        if first >= 0:
            m = mat34()
            for k in range(12):
                m[k / 4, k % 4] = data.inputs.attribute_values[first + 2 + k]
            place = transform_point(m, transform_point(world_to_object(data, point), point.position))
            address = _grid_address(data, first)
            alpha = 1.0
            if data.inputs.attribute_layout[row, which] == 1:
                color = wp.vec3(wp.volume_sample_f(address, place, wp.Volume.LINEAR))
            else:
                color = wp.volume_sample_v(address, place, wp.Volume.LINEAR)
    put_vector(data, stack, pc + 3, color)
    put_number(data, stack, pc + 4, (color[0] + color[1] + color[2]) * wp.static(1.0 / 3.0))
    put_number(data, stack, pc + 5, alpha)
