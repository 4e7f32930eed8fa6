"""Colour ramps, baked to tables."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector
from ...point import ShadingPoint
from .tables import read_table

RAMP_SIZE = 257  # entries of red, green, blue and alpha, 1/256 apart


@op("color_ramp", "int>VN")
@wp.func
def color_ramp(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Whether entries are interpolated, factor, table > colour, alpha."""
    interpolate = data.code[pc + 1]
    x = number(data, stack, pc + 2)
    first = data.code[pc + 3]
    color = wp.vec4(0.0, 0.0, 0.0, 0.0)
    count = int(4)
    for i in range(count):
        color[i] = read_table(data.constants, first + i, 4, RAMP_SIZE, x, interpolate, 0)
    put_vector(data, stack, pc + 4, wp.vec3(color[0], color[1], color[2]))
    put_number(data, stack, pc + 5, color[3])
