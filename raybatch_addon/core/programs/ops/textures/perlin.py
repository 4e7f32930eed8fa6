"""Gradient noise in one to four dimensions, on the lattice of integers, as in Blender.

K. Perlin, "Improving noise" (SIGGRAPH 2002), with lookup3 (`hashing.py`) instead of a table of permutations.
`signed_noise_*` is about in [-1, 1], 0 at lattice points, and smooth within (-100,000, 100,000). Beyond, floats are
coarse, and it repeats every 100,000. From 1,000,000 on it is shifted by half a cell, since it would be 0 at the whole
numbers that are left. A coordinate that is not finite is taken as 0.

Sums and products are rounded where Cycles rounds them, and axes are in its order: many octaves, and distortion by
noise, amplify a last bit.
"""

import warp as wp

from ....native.build import native_source
from ..values.finite import finite_or_zero
from .hashing import HASH_SEED_3, hash_bits_1, hash_bits_2, hash_bits_4

PERIOD = 100000.0
SHIFTED_FROM = 1000000.0

# Factors that bring each dimension's noise to about [-1, 1]: Open Shading Language's figures, measured there
_SCALE_1 = wp.constant(0.25)
_SCALE_2 = wp.constant(0.6616)
_SCALE_3 = wp.constant(0.982)
_SCALE_4 = wp.constant(0.8344)

_PERIOD = wp.constant(PERIOD)
_ONE_OVER_PERIOD = wp.constant(1.0e-5)
_SHIFTED_FROM = wp.constant(SHIFTED_FROM)
_BEYOND_INT = wp.constant(2.0**31)
_LEAST_INT = wp.constant(-(2**31))


@wp.func
def floor_to_int(x: float) -> int:
    """The integer at or below `x`; the least int32 where 32 bits do not hold it, or for NaN (as x86 converts)."""
    below = wp.floor(x)
    if below >= -_BEYOND_INT and below < _BEYOND_INT:
        return int(below)
    return _LEAST_INT


@wp.func
def _shift(x: float) -> float:
    return wp.where(wp.abs(x) >= _SHIFTED_FROM, 0.5, 0.0)


@wp.func
def _wrap_exact(x: float) -> float:
    """`x` within the period, by the exact remainder, as Blender computes it in one and two dimensions."""
    if wp.abs(x) < _PERIOD:
        return x
    return finite_or_zero(wp.mod(x, _PERIOD) + _shift(x))


@wp.func
def _wrap(x: float) -> float:
    """`x` within the period, by a rounded quotient (a product), as Blender computes it in three and four dimensions."""
    if wp.abs(x) < _PERIOD:
        return x
    return finite_or_zero(x - wp.trunc(x * _ONE_OVER_PERIOD) * _PERIOD + _shift(x))


@wp.func_native(native_source("math/fused_sum.h"))
def sum_with_product(a: float, b: float, c: float) -> float:
    """a + b * c, rounded once."""


@wp.func
def _fade(t: float) -> float:
    """Perlin's quintic step."""
    return (t * t) * (t * sum_with_product(10.0, t, sum_with_product(-15.0, t, 6.0)))


@wp.func
def _mix(a: float, b: float, t: float) -> float:
    return a + t * (b - a)


@wp.func
def _flip(value: float, bits: wp.uint32, bit: wp.uint32) -> float:
    return wp.where((bits & bit) != wp.uint32(0), -value, value)


@wp.func
def _slope_1(i: wp.uint32, x: float) -> float:
    """Contribution of a lattice point at distance `x` from it: its random slope times the distance."""
    bits = hash_bits_1(i)
    return _flip(1.0 + wp.float32(bits & wp.uint32(7)), bits, wp.uint32(8)) * x


@wp.func
def _slope_2(i: wp.uint32, j: wp.uint32, x: float, y: float) -> float:
    bits = hash_bits_2(i, j)
    along_x = (bits & wp.uint32(4)) == wp.uint32(0)
    u = wp.where(along_x, x, y)
    v = 2.0 * wp.where(along_x, y, x)
    return _flip(u, bits, wp.uint32(1)) + _flip(v, bits, wp.uint32(2))


@wp.func
def _slope_4(i: wp.uint32, j: wp.uint32, k: wp.uint32, m: wp.uint32, at: wp.vec4) -> float:
    bits = hash_bits_4(i, j, k, m)
    h = bits & wp.uint32(31)
    u = wp.where(h < wp.uint32(24), at[0], at[1])
    v = wp.where(h < wp.uint32(16), at[1], at[2])
    s = wp.where(h < wp.uint32(8), at[2], at[3])
    return _flip(u, bits, wp.uint32(1)) + _flip(v, bits, wp.uint32(2)) + _flip(s, bits, wp.uint32(4))


@wp.func
def _row_2(i: wp.uint32, j: wp.uint32, x: float, y: float, u: float) -> float:
    """Noise between two lattice points along x."""
    return _mix(_slope_2(i, j, x, y), _slope_2(i + wp.uint32(1), j, x - 1.0, y), u)


@wp.func_native(native_source("noise/cell_3.h", HASH_SEED=HASH_SEED_3))
def _cell_3(i: wp.uint32, j: wp.uint32, k: wp.uint32, at: wp.vec3, fade: wp.vec3) -> float:
    """Noise at `at` in [0, 1) from the lattice point (i, j, k); `fade` is the step of each axis there."""


@wp.func
def _column_4(i: wp.uint32, j: wp.uint32, k: wp.uint32, m: wp.uint32, at: wp.vec4, s: float) -> float:
    """Noise between two lattice points along w."""
    return _mix(
        _slope_4(i, j, k, m, at), _slope_4(i, j, k, m + wp.uint32(1), wp.vec4(at[0], at[1], at[2], at[3] - 1.0)), s
    )


@wp.func
def _row_4(i: wp.uint32, j: wp.uint32, k: wp.uint32, m: wp.uint32, at: wp.vec4, s: float, u: float) -> float:
    next_at = wp.vec4(at[0] - 1.0, at[1], at[2], at[3])
    return _mix(_column_4(i, j, k, m, at, s), _column_4(i + wp.uint32(1), j, k, m, next_at, s), u)


@wp.func
def signed_noise_1d(p: float) -> float:
    """Noise on a line."""
    x = _wrap_exact(p)
    i = wp.uint32(floor_to_int(x))
    x -= wp.floor(x)
    near = _slope_1(i, x)
    step = x * x * x * sum_with_product(10.0, x, sum_with_product(-15.0, x, 6.0))
    return _SCALE_1 * sum_with_product(near, step, _slope_1(i + wp.uint32(1), x - 1.0) - near)


@wp.func
def signed_noise_2d(p: wp.vec2) -> float:
    """Noise in the plane."""
    x = _wrap_exact(p[0])
    y = _wrap_exact(p[1])
    i = wp.uint32(floor_to_int(x))
    j = wp.uint32(floor_to_int(y))
    x -= wp.floor(x)
    y -= wp.floor(y)
    u = _fade(x)
    return _SCALE_2 * _mix(_row_2(i, j, x, y, u), _row_2(i, j + wp.uint32(1), x, y - 1.0, u), _fade(y))


@wp.func
def signed_noise_3d(p: wp.vec3) -> float:
    """Noise in space."""
    q = wp.vec3(_wrap(p[0]), _wrap(p[1]), _wrap(p[2]))
    i = wp.uint32(floor_to_int(q[0]))
    j = wp.uint32(floor_to_int(q[1]))
    k = wp.uint32(floor_to_int(q[2]))
    at = wp.vec3(q[0] - wp.floor(q[0]), q[1] - wp.floor(q[1]), q[2] - wp.floor(q[2]))
    fade = wp.vec3(_fade(at[0]), _fade(at[1]), _fade(at[2]))
    return _SCALE_3 * _cell_3(i, j, k, at, fade)


@wp.func
def signed_noise_4d(p: wp.vec4) -> float:
    """Noise in four dimensions."""
    q = wp.vec4(_wrap(p[0]), _wrap(p[1]), _wrap(p[2]), _wrap(p[3]))
    i = wp.uint32(floor_to_int(q[0]))
    j = wp.uint32(floor_to_int(q[1]))
    k = wp.uint32(floor_to_int(q[2]))
    m = wp.uint32(floor_to_int(q[3]))
    at = wp.vec4(q[0] - wp.floor(q[0]), q[1] - wp.floor(q[1]), q[2] - wp.floor(q[2]), q[3] - wp.floor(q[3]))
    u = _fade(at[0])
    v = _fade(at[1])
    w = _fade(at[2])
    s = _fade(at[3])
    noise = float(0.0)
    # a variable, so that the loop stays one and holds the code of a lattice point half as often
    layers = int(2)
    for layer in range(layers):
        near = _row_4(i, j, k, m, at, s, u)
        far = _row_4(i, j + wp.uint32(1), k, m, wp.vec4(at[0], at[1] - 1.0, at[2], at[3]), s, u)
        plane = _mix(near, far, v)
        noise = wp.where(layer == 0, plane, _mix(noise, plane, w))
        k += wp.uint32(1)
        at[2] -= 1.0
    return _SCALE_4 * noise
