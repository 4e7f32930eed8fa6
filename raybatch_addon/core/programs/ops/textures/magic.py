"""Magic texture: psychedelic colours from sines of sums of sines."""

import warp as wp

from ....float32 import TWO_PI
from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from ..values.finite import finite_or_zero

MAGIC_DEPTH_MAX = 10


@wp.func
def _angle(x: float) -> float:
    return finite_or_zero(wp.mod(x, TWO_PI))


@wp.func
def magic(p: wp.vec3, depth: int, distortion: float) -> wp.vec3:
    """The colour at `p`, each channel about in [0, 1]; `depth` sines, `MAGIC_DEPTH_MAX` at most, follow the first
    three.
    """
    a = _angle(p[0])
    b = _angle(p[1])
    c = _angle(p[2])
    d = distortion
    x = wp.sin((a + b + c) * 5.0)
    y = wp.cos((-a + b - c) * 5.0)
    z = -wp.cos((-a - b + c) * 5.0)
    if depth > 0:
        x *= d
        z *= d
        y = -wp.cos(x - y * d + z) * d
    if depth > 1:
        x = wp.cos(x - y - z) * d
    if depth > 2:
        z = wp.sin(-x - y - z) * d
    if depth > 3:
        x = -wp.cos(-x + y - z) * d
    if depth > 4:
        y = -wp.sin(-x + y + z) * d
    if depth > 5:
        y = -wp.cos(-x + y + z) * d
    if depth > 6:
        x = wp.cos(x + y + z) * d
    if depth > 7:
        z = wp.sin(x + y - z) * d
    if depth > 8:
        x = -wp.cos(-x - y + z) * d
    if depth > 9:
        y = -wp.sin(x - y + z) * d
    if d != 0.0:
        x /= d * 2.0
        y /= d * 2.0
        z /= d * 2.0
    return wp.vec3(finite_or_zero(0.5 - x), finite_or_zero(0.5 - y), finite_or_zero(0.5 - z))


@op("magic", "ivnn>NV")
@wp.func
def magic_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Magic texture, factor (the channels' mean) and colour: depth, vector, scale, distortion."""
    color = magic(
        vector(data, stack, pc + 2) * number(data, stack, pc + 3), data.code[pc + 1], number(data, stack, pc + 4)
    )
    put_number(data, stack, pc + 5, (color[0] + color[1] + color[2]) / 3.0)
    put_vector(data, stack, pc + 6, color)
