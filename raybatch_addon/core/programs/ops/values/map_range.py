"""Numbers and vectors from one range to another."""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .math import evaluate_clamp, safe_divide, saturated


class RangeInterpolation(IntEnum):
    """How a range is mapped to another."""

    LINEAR = 0
    STEPPED = 1
    SMOOTHSTEP = 2
    SMOOTHERSTEP = 3


@wp.func
def _stepped(factor: float, steps: float) -> float:
    if steps > 0.0:
        return wp.floor(factor * (steps + 1.0)) / steps
    return 0.0


@wp.func
def _eased(interpolation: int, factor: float) -> float:
    t = saturated(factor)
    if interpolation == RangeInterpolation.SMOOTHSTEP:
        return (3.0 - 2.0 * t) * (t * t)
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def map_component(
    interpolation: int,
    clamp: int,
    x: float,
    from_min: float,
    from_max: float,
    to_min: float,
    to_max: float,
    steps: float,
) -> float:
    """`x` mapped; an empty range gives `to_min`."""
    factor = safe_divide(x - from_min, from_max - from_min)
    if interpolation == RangeInterpolation.STEPPED:
        factor = _stepped(factor, steps)
    if interpolation >= RangeInterpolation.SMOOTHSTEP:
        return to_min + _eased(interpolation, factor) * (to_max - to_min)
    result = to_min + factor * (to_max - to_min)
    if clamp == 1:
        return evaluate_clamp(1, result, to_min, to_max)
    return result


@wp.func
def map_number(
    interpolation: int,
    clamp: int,
    x: float,
    from_min: float,
    from_max: float,
    to_min: float,
    to_max: float,
    steps: float,
) -> float:
    """`x` mapped; an empty range gives 0, clamped to `to_min` .. `to_max` where `clamp` is 1."""
    if from_min == from_max:
        if clamp == 1:
            return evaluate_clamp(1, 0.0, to_min, to_max)
        return 0.0
    return map_component(interpolation, clamp, x, from_min, from_max, to_min, to_max, steps)


@op("map_range", "iinnnnnn>N")
@wp.func
def map_range(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Map range of a number.

    Operands: interpolation, whether the result is clamped, number, from least and greatest, to least and greatest,
    steps > number.
    """
    x = number(data, stack, pc + 3)
    from_min = number(data, stack, pc + 4)
    from_max = number(data, stack, pc + 5)
    to_min = number(data, stack, pc + 6)
    to_max = number(data, stack, pc + 7)
    steps = number(data, stack, pc + 8)
    put_number(
        data,
        stack,
        pc + 9,
        map_number(data.code[pc + 1], data.code[pc + 2], x, from_min, from_max, to_min, to_max, steps),
    )


@op("map_range_vector", "iivvvvvv>V")
@wp.func
def map_range_vector(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Map range of a vector, by component; operands as those of `map_range`."""
    interpolation = data.code[pc + 1]
    clamp = data.code[pc + 2]
    x = vector(data, stack, pc + 3)
    from_min = vector(data, stack, pc + 4)
    from_max = vector(data, stack, pc + 5)
    to_min = vector(data, stack, pc + 6)
    to_max = vector(data, stack, pc + 7)
    steps = vector(data, stack, pc + 8)
    result = wp.vec3(0.0, 0.0, 0.0)
    count = int(3)
    for i in range(count):
        result[i] = map_component(interpolation, clamp, x[i], from_min[i], from_max[i], to_min[i], to_max[i], steps[i])
    put_vector(data, stack, pc + 9, result)
