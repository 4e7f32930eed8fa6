"""Inputs of volumes: where a point is in the world's, and values that an object has at points of space, by name."""

import warp as wp

from ....scene.geometry import mat34, transform_point
from ...object_space import world_to_object
from ...op import NodeData, number, op, put_number, put_vector
from ...point import ShadingPoint, shifted_position

# In the table of attributes of volumes an entry has these numbers: two halves of the address of a `wp.Volume`, and the
# map from object space to its indices
GRID_NUMBERS = 14
# Ops that read grids
GRID_OPS = ("volume_attribute", "volume_attribute_cubic")


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


@wp.func
def _first_number(data: NodeData, which: int, point: ShadingPoint) -> int:
    """Where the numbers of the grid of an attribute begin; -1: the object has none of that name."""
    if point.instance < 0 or which < 0 or which >= data.inputs.attribute_first.shape[1]:
        return -1
    return data.inputs.attribute_first[data.inputs.attribute_row[point.instance], which]


@wp.func
def _index_in(data: NodeData, first: int, point: ShadingPoint) -> wp.vec3:
    """The point in indices of the grid."""
    m = mat34()
    for k in range(12):
        m[k / 4, k % 4] = data.inputs.attribute_values[first + 2 + k]
    return transform_point(m, transform_point(world_to_object(data, point), point.position))


@wp.func
def _linear(data: NodeData, first: int, width: int, place: wp.vec3) -> wp.vec3:
    address = _grid_address(data, first)
    if width == 1:
        return wp.vec3(wp.volume_sample_f(address, place, wp.Volume.LINEAR))
    return wp.volume_sample_v(address, place, wp.Volume.LINEAR)


@wp.func
def _cubic(data: NodeData, first: int, width: int, place: wp.vec3) -> wp.vec3:
    """By the uniform cubic B-spline, where four voxels count along each axis: a mean of eight linear values (Sigg and
    Hadwiger, "Fast Third-Order Texture Filtering", 2005).
    """
    share = wp.vec3()  # of the two voxels behind
    before = wp.vec3()  # places between the two voxels before, and the two behind
    behind = wp.vec3()
    for axis in range(3):
        whole = wp.floor(place[axis])
        t = place[axis] - whole
        u = 1.0 - t
        outer = t * t * t / 6.0
        share[axis] = (1.0 + 3.0 * t + 3.0 * t * t - 3.0 * t * t * t) / 6.0 + outer
        nearer = (1.0 + 3.0 * u + 3.0 * u * u - 3.0 * u * u * u) / 6.0
        before[axis] = whole - 1.0 + nearer / (1.0 - share[axis])
        behind[axis] = whole + 1.0 + outer / share[axis]
    total = wp.vec3()
    for corner in range(8):
        at = before
        weight = float(1.0)
        for axis in range(3):
            if ((corner >> axis) & 1) == 1:
                at[axis] = behind[axis]
                weight *= share[axis]
            else:
                weight *= 1.0 - share[axis]
        total += weight * _linear(data, first, width, at)
    return total


@wp.func
def _put_grid(data: NodeData, stack: wp.array(dtype=float), pc: int, color: wp.vec3, alpha: float):
    put_vector(data, stack, pc + 3, color)
    put_number(data, stack, pc + 4, (color[0] + color[1] + color[2]) * wp.static(1.0 / 3.0))
    put_number(data, stack, pc + 5, alpha)


@op("volume_attribute", "an>VNN", foldable=False)
@wp.func
def volume_attribute(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Grid of an object as colour, number and alpha; operand 2 is the value where the object has none of that name."""
    color = wp.vec3(number(data, stack, pc + 2))
    alpha = float(0.0)
    first = _first_number(data, data.code[pc + 1], point)
    if first >= 0:
        width = data.inputs.attribute_layout[data.inputs.attribute_row[point.instance], data.code[pc + 1]]
        color = _linear(data, first, width, _index_in(data, first, point))
        alpha = 1.0
    _put_grid(data, stack, pc, color, alpha)


@op("volume_attribute_cubic", "an>VNN", foldable=False, general=False)
@wp.func
def volume_attribute_cubic(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The same, smoothly between voxels."""
    color = wp.vec3(number(data, stack, pc + 2))
    alpha = float(0.0)
    first = _first_number(data, data.code[pc + 1], point)
    if first >= 0:
        width = data.inputs.attribute_layout[data.inputs.attribute_row[point.instance], data.code[pc + 1]]
        color = _cubic(data, first, width, _index_in(data, first, point))
        alpha = 1.0
    _put_grid(data, stack, pc, color, alpha)
