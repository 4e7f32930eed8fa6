"""Tables of numbers among the constants, interpolated between their entries."""

import warp as wp

from .math import saturated


@wp.func
def table_position(x: float, count: int) -> float:
    """Position of `x` in [0, 1] among `count` entries.

    Beyond the ends it is that of the nearest end, for NaN that of the first.
    """
    return saturated(x) * float(count - 1)


@wp.func
def read_table(
    constants: wp.array(dtype=float), first: int, stride: int, count: int, x: float, interpolate: int, extrapolate: int
) -> float:
    """Value at `x` in [0, 1] of a table of `count` entries, each `stride` numbers after the last.

    Beyond the ends it is the end's value, or where `extrapolate` is 1 that of the straight line through the last two
    entries. Without `interpolate` it is the entry at or below `x`.
    """
    last = first + (count - 1) * stride
    if extrapolate == 1 and x < 0.0:
        slope = constants[first] - constants[first + stride]
        return constants[first] - slope * x * float(count - 1)
    if extrapolate == 1 and x > 1.0:
        slope = constants[last] - constants[last - stride]
        return constants[last] + slope * (x - 1.0) * float(count - 1)
    position = table_position(x, count)
    i = int(position)
    t = position - float(i)
    at = first + i * stride
    if interpolate == 1 and t > 0.0:
        return (1.0 - t) * constants[at] + t * constants[at + stride]
    return constants[at]
