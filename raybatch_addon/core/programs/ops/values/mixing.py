"""Mixes of numbers, vectors and colours; colours by every blend mode, one op for all."""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .color_spaces import hsv_to_rgb, rgb_to_hsv
from .math import greater, lesser, saturated


class BlendMode(IntEnum):
    """Blend modes of `mix_color`; those up to DIVIDE work channel by channel."""

    MIX = 0
    DARKEN = 1
    MULTIPLY = 2
    BURN = 3
    LIGHTEN = 4
    SCREEN = 5
    DODGE = 6
    ADD = 7
    OVERLAY = 8
    SOFT_LIGHT = 9
    LINEAR_LIGHT = 10
    DIFFERENCE = 11
    EXCLUSION = 12
    SUBTRACT = 13
    DIVIDE = 14
    HUE = 15
    SATURATION = 16
    COLOR = 17
    VALUE = 18


@wp.func
def _between(a: float, b: float, t: float) -> float:
    return a + t * (b - a)


@wp.func
def blend_channel(mode: int, t: float, a: float, b: float) -> float:
    """One channel of two colours by a `BlendMode` up to DIVIDE, of strength `t`."""
    rest = 1.0 - t
    if mode == BlendMode.MIX:
        return _between(a, b, t)
    if mode == BlendMode.DARKEN:
        return _between(a, lesser(a, b), t)
    if mode == BlendMode.MULTIPLY:
        return _between(a, a * b, t)
    if mode == BlendMode.BURN:
        floor = rest + t * b
        if floor <= 0.0:
            return 0.0
        return limited_channel(1.0 - (1.0 - a) / floor)
    if mode == BlendMode.LIGHTEN:
        return _between(a, greater(a, b), t)
    if mode == BlendMode.SCREEN:
        return 1.0 - (rest + t * (1.0 - b)) * (1.0 - a)
    if mode == BlendMode.DODGE:
        if a == 0.0:
            return 0.0
        floor = 1.0 - t * b
        if floor <= 0.0 or a / floor > 1.0:
            return 1.0
        return a / floor
    if mode == BlendMode.ADD:
        return _between(a, a + b, t)
    if mode == BlendMode.OVERLAY:
        if a < 0.5:
            return a * (rest + 2.0 * t * b)
        return 1.0 - (rest + 2.0 * t * (1.0 - b)) * (1.0 - a)
    if mode == BlendMode.SOFT_LIGHT:
        screen = 1.0 - (1.0 - b) * (1.0 - a)
        return rest * a + t * ((1.0 - a) * b * a + a * screen)
    if mode == BlendMode.LINEAR_LIGHT:
        return a + t * (2.0 * b - 1.0)
    if mode == BlendMode.DIFFERENCE:
        return _between(a, wp.abs(a - b), t)
    if mode == BlendMode.EXCLUSION:
        return greater(_between(a, a + b - 2.0 * a * b, t), 0.0)
    if mode == BlendMode.SUBTRACT:
        return _between(a, a - b, t)
    if b != 0.0:
        return rest * a + t * a / b
    return a


@wp.func
def limited_channel(x: float) -> float:
    """`x` within [0, 1]; NaN stays."""
    if x < 0.0:
        return 0.0
    if x > 1.0:
        return 1.0
    return x


@wp.func
def _blend_hsv(mode: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    one = rgb_to_hsv(a)
    other = rgb_to_hsv(b)
    hue = one[0]
    saturation = one[1]
    value = one[2]
    if mode == BlendMode.SATURATION:
        if saturation == 0.0:  # a grey has no hue that could be saturated
            return a
        saturation = (1.0 - t) * saturation + t * other[1]
    elif mode == BlendMode.VALUE:
        value = (1.0 - t) * value + t * other[2]
    else:
        if other[1] == 0.0:  # a grey has no hue to give
            return a
        hue = other[0]
        if mode == BlendMode.COLOR:
            saturation = other[1]
    blended = hsv_to_rgb(wp.vec3(hue, saturation, value))
    if mode == BlendMode.HUE or mode == BlendMode.COLOR:
        return a + t * (blended - a)
    return blended


@wp.func
def blend_colors(mode: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Colours `a` and `b` mixed by a `BlendMode` of strength `t`."""
    if mode >= BlendMode.HUE:
        return _blend_hsv(mode, t, a, b)
    result = wp.vec3(0.0, 0.0, 0.0)
    # a loop that Warp does not unroll keeps one copy of the modes in the kernel
    count = int(3)
    for i in range(count):
        result[i] = blend_channel(mode, t, a[i], b[i])
    return result


@wp.func
def evaluate_mix_color(mode: int, clamp_factor: int, clamp_result: int, t: float, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """`blend_colors` with factor and result limited to [0, 1] where the flags are 1."""
    if clamp_factor == 1:
        t = saturated(t)
    result = blend_colors(mode, t, a, b)
    if clamp_result == 1:
        result = wp.vec3(saturated(result[0]), saturated(result[1]), saturated(result[2]))
    return result


@wp.func
def evaluate_mix_float(clamp_factor: int, t: float, a: float, b: float) -> float:
    """Mixture of `a` (factor 0) and `b` (factor 1), also beyond unless `clamp_factor` is 1."""
    if clamp_factor == 1:
        t = saturated(t)
    return a * (1.0 - t) + b * t


@op("mix_float", "innn>N")
@wp.func
def mix_float(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Whether the factor is clamped, factor, a, b > result."""
    t = number(data, stack, pc + 2)
    a = number(data, stack, pc + 3)
    b = number(data, stack, pc + 4)
    put_number(data, stack, pc + 5, evaluate_mix_float(data.code[pc + 1], t, a, b))


@op("mix_vector", "ivvv>V")
@wp.func
def mix_vector(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Whether the factors are clamped, factor of each component, a, b > result."""
    clamp = data.code[pc + 1]
    t = vector(data, stack, pc + 2)
    a = vector(data, stack, pc + 3)
    b = vector(data, stack, pc + 4)
    x = evaluate_mix_float(clamp, t[0], a[0], b[0])
    y = evaluate_mix_float(clamp, t[1], a[1], b[1])
    z = evaluate_mix_float(clamp, t[2], a[2], b[2])
    put_vector(data, stack, pc + 5, wp.vec3(x, y, z))


@op("mix_color", "iiinvv>V")
@wp.func
def mix_color(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Blend mode, whether the factor is clamped, whether the result is, factor, a, b > result."""
    t = number(data, stack, pc + 4)
    a = vector(data, stack, pc + 5)
    b = vector(data, stack, pc + 6)
    put_vector(
        data, stack, pc + 7, evaluate_mix_color(data.code[pc + 1], data.code[pc + 2], data.code[pc + 3], t, a, b)
    )
