"""Gradients: numbers in [0, 1] that follow from a point's position."""

from enum import IntEnum

import warp as wp

from ....float32 import TWO_PI
from ...op import NodeData, op, put_number, put_vector, vector
from ...point import ShadingPoint


class GradientKind(IntEnum):
    """How the number follows from the point."""

    LINEAR = 0  # x
    QUADRATIC = 1  # x squared
    EASING = 2  # x, eased in and out
    DIAGONAL = 3  # mean of x and y
    RADIAL = 4  # angle about z, from -x over -y
    QUADRATIC_SPHERE = 5  # the square of SPHERICAL
    SPHERICAL = 6  # 1 at the origin, 0 from distance 1 on


_LINEAR = wp.constant(int(GradientKind.LINEAR))
_QUADRATIC = wp.constant(int(GradientKind.QUADRATIC))
_EASING = wp.constant(int(GradientKind.EASING))
_DIAGONAL = wp.constant(int(GradientKind.DIAGONAL))
_RADIAL = wp.constant(int(GradientKind.RADIAL))
_QUADRATIC_SPHERE = wp.constant(int(GradientKind.QUADRATIC_SPHERE))
_RADIUS = wp.constant(0.999999)  # just below 1, so that rounding leaves nothing at distance 1


@wp.func
def gradient(kind: int, p: wp.vec3) -> float:
    """The gradient at `p`, in [0, 1]; 0 where it is not defined."""
    value = float(0.0)
    if kind == _LINEAR:
        value = p[0]
    elif kind == _QUADRATIC:
        value = wp.max(p[0], 0.0) * wp.max(p[0], 0.0)
    elif kind == _EASING:
        x = wp.clamp(p[0], 0.0, 1.0)
        value = 3.0 * x * x - 2.0 * x * x * x
    elif kind == _DIAGONAL:
        value = (p[0] + p[1]) * 0.5
    elif kind == _RADIAL:
        value = wp.atan2(p[1], p[0]) / TWO_PI + 0.5
    else:
        value = wp.max(_RADIUS - wp.length(p), 0.0)
        if kind == _QUADRATIC_SPHERE:
            value *= value
    if not (value > 0.0):  # NaN too
        return 0.0
    return wp.min(value, 1.0)


@op("gradient", "iv>NV")
@wp.func
def gradient_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Gradient texture, factor and colour: `GradientKind`, vector."""
    value = gradient(data.code[pc + 1], vector(data, stack, pc + 2))
    put_number(data, stack, pc + 3, value)
    put_vector(data, stack, pc + 4, wp.vec3(value, value, value))
