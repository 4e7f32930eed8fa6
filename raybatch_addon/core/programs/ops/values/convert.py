"""Conversions between sockets of different kinds, and products of colours."""

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint


@op("splat", "n>V")
@wp.func
def splat(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Vector of a number three times."""
    x = number(data, stack, pc + 1)
    put_vector(data, stack, pc + 2, wp.vec3(x, x, x))


@op("luminance", "v>N")
@wp.func
def luminance(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Luminance of linear Rec. 709 (IEC 61966-2-1, to all digits)."""
    c = vector(data, stack, pc + 1)
    put_number(data, stack, pc + 2, 0.21263901 * c[0] + 0.71516868 * c[1] + 0.07219232 * c[2])


@op("average", "v>N")
@wp.func
def average(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Mean of a vector's components."""
    v = vector(data, stack, pc + 1)
    put_number(data, stack, pc + 2, (v[0] + v[1] + v[2]) * wp.static(1.0 / 3.0))


@op("truncate", "n>N")
@wp.func
def truncate(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Number rounded towards 0, as for integer sockets."""
    x = number(data, stack, pc + 1)
    whole = wp.floor(wp.abs(x))
    if x < 0.0:
        whole = -whole
    put_number(data, stack, pc + 2, whole)


@op("is_positive", "n>N")
@wp.func
def is_positive(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """1 where a number is above 0, else 0, as for boolean sockets."""
    truth = float(0.0)
    if number(data, stack, pc + 1) > 0.0:
        truth = 1.0
    put_number(data, stack, pc + 2, truth)


@op("multiply_colors", "vv>V")
@wp.func
def multiply_colors(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Product of two colours, channel by channel."""
    put_vector(data, stack, pc + 3, wp.cw_mul(vector(data, stack, pc + 1), vector(data, stack, pc + 2)))


@op("mix_weights", "vn>VV")
@wp.func
def mix_weights(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Weights of two shaders: a weight shared by a factor, which is clamped to 0..1."""
    weight = vector(data, stack, pc + 1)
    share = wp.clamp(number(data, stack, pc + 2), 0.0, 1.0)
    put_vector(data, stack, pc + 3, (1.0 - share) * weight)
    put_vector(data, stack, pc + 4, share * weight)
