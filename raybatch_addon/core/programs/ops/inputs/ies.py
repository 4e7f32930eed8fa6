"""Photometric profiles of lamps (IES)."""

import numpy as np
import warp as wp

from ...op import NodeData, number, op, put_number, vector
from ...point import ShadingPoint

# Intensity of a file that cannot be used, in Cycles
WITHOUT_PROFILE = 100.0
_HALF_TURN = float(np.float32(np.pi))
# A table that begins or ends this near to a pole, or goes this far around, is continued beyond its edge. In float32,
# as in Cycles: there is no number so near below a whole turn, nor below a half, so that of the edges only the lower
# pole ever counts
_AROUND = float(np.float32(2 * np.pi) - np.float32(1e-7))
_UPPER_POLE = float(np.float32(np.pi) - np.float32(1e-7))
_LOWER_POLE = float(np.float32(1e-7))


@wp.func
def cubic_between(a: float, b: float, c: float, d: float, x: float) -> float:
    """Value at the share `x` between the second and the third of four values, on Catmull and Rom's curve."""
    slope = 0.5 * (c - a)
    bend = a - 2.5 * b + 2.0 * c - 0.5 * d
    twist = 0.5 * (d - a) + 1.5 * (b - c)
    return ((twist * x + bend) * x + slope) * x + b


@wp.func
def entry_before(constants: wp.array(dtype=float), first: int, count: int, angle: float) -> int:
    """Index of the entry before the first that is not below `angle`; the last entry does not count."""
    i = int(0)
    while i + 2 < count and constants[first + i + 1] < angle:
        i += 1
    return i


@wp.func
def share_between(low: float, high: float, angle: float) -> float:
    """Position of `angle` between `low` and `high`, as a share; 0 if both are the same."""
    result = float(0.0)
    if high != low:
        result = (angle - low) / (high - low)
    return result


@wp.func
def along_row(
    constants: wp.array(dtype=float), row: int, count: int, i: int, x: float, from_pole: bool, to_pole: bool
) -> float:
    """Intensity of one row between entries `i` and `i` + 1; beyond a pole the row is taken to be mirrored."""
    b = constants[row + i]
    c = constants[row + i + 1]
    a = b
    if i > 0:
        a = constants[row + i - 1]
    elif from_pole:
        a = constants[row + 1]
    d = c
    if i + 2 < count:
        d = constants[row + i + 2]
    elif to_pole:
        d = constants[row + count - 2]
    return cubic_between(a, b, c, d, x)


@wp.func
def profile_intensity(
    constants: wp.array(dtype=float), first: int, horizontal_count: int, vertical_count: int, direction: wp.vec3
) -> float:
    """Intensity of the `LightProfile.table` at `first` for light that leaves against `direction`.

    It is 0 beyond the table's angles, and for a vector without direction. A table without horizontal angles is no
    profile.
    """
    if horizontal_count < 2:
        return wp.static(WITHOUT_PROFILE)
    length = wp.length(direction)
    if not (length > 0.0 and length < wp.inf):
        return 0.0
    vertical_angle = wp.acos(wp.clamp(-direction[2] / length, -1.0, 1.0))
    horizontal_angle = wp.atan2(direction[0], direction[1]) + wp.static(_HALF_TURN)
    vertical = first + horizontal_count
    low = constants[vertical]
    high = constants[vertical + vertical_count - 1]
    left = constants[first]
    right = constants[first + horizontal_count - 1]
    if vertical_angle < low or vertical_angle >= high or horizontal_angle < left or horizontal_angle >= right:
        return 0.0
    from_pole = low < wp.static(_LOWER_POLE)
    to_pole = high > wp.static(_UPPER_POLE)
    around = left < wp.static(_LOWER_POLE) and right > wp.static(_AROUND)

    h = entry_before(constants, first, horizontal_count, horizontal_angle)
    v = entry_before(constants, vertical, vertical_count, vertical_angle)
    x = share_between(constants[first + h], constants[first + h + 1], horizontal_angle)
    y = share_between(constants[vertical + v], constants[vertical + v + 1], vertical_angle)
    row = vertical + vertical_count
    b = along_row(constants, row + h * vertical_count, vertical_count, v, y, from_pole, to_pole)
    c = along_row(constants, row + (h + 1) * vertical_count, vertical_count, v, y, from_pole, to_pole)
    # at the edges the second value stands for values beyond: also after the last, where the third would be expected
    a = b
    d = b
    before = h - 1
    after = h + 2
    if around and before < 0:
        before = horizontal_count - 2
    if around and after >= horizontal_count:
        after = 1
    if before >= 0:
        a = along_row(constants, row + before * vertical_count, vertical_count, v, y, from_pole, to_pole)
    if after < horizontal_count:
        d = along_row(constants, row + after * vertical_count, vertical_count, v, y, from_pole, to_pole)
    return wp.max(cubic_between(a, b, c, d, x), 0.0)


@op("ies", "tiivn>N")
@wp.func
def ies(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Photometric profile: table, numbers of its horizontal and vertical angles, direction, strength."""
    intensity = profile_intensity(
        data.constants, data.code[pc + 1], data.code[pc + 2], data.code[pc + 3], vector(data, stack, pc + 4)
    )
    put_number(data, stack, pc + 6, number(data, stack, pc + 5) * intensity)
