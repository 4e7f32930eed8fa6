"""Cubes of unit size in two colours."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .perlin import floor_to_int

# Blender's nudge: coordinates 0 and 1, which faces of cubes have, are both within the first cell
NUDGE = wp.constant(0.000001)
SHRINK = wp.constant(0.999999)


@wp.func
def checker(p: wp.vec3) -> float:
    """1 in every other unit cube, 0 between. Beyond 32 bits, and for NaN, a coordinate counts as even."""
    i = floor_to_int((p[0] + NUDGE) * SHRINK) & 1
    j = floor_to_int((p[1] + NUDGE) * SHRINK) & 1
    k = floor_to_int((p[2] + NUDGE) * SHRINK) & 1
    return wp.where((i ^ j ^ k) == 1, 1.0, 0.0)


@op("checker", "vvvn>NV")
@wp.func
def checker_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Checker texture, factor and colour: vector, colour where the factor is 1, colour where it is 0, scale."""
    value = checker(vector(data, stack, pc + 1) * number(data, stack, pc + 4))
    put_number(data, stack, pc + 5, value)
    if value == 1.0:
        put_vector(data, stack, pc + 6, vector(data, stack, pc + 2))
    else:
        put_vector(data, stack, pc + 6, vector(data, stack, pc + 3))
