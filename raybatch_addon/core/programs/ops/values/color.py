"""Colours taken apart, put together and corrected."""

from enum import IntEnum

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from .color_spaces import hsl_to_rgb, hsv_to_rgb, rgb_to_hsl, rgb_to_hsv
from .math import fraction, greater, saturated


class ColorModel(IntEnum):
    """Meaning of the three numbers of a colour."""

    RGB = 0
    HSV = 1
    HSL = 2


@wp.func
def combine(model: int, c: wp.vec3) -> wp.vec3:
    """RGB of three numbers of a `ColorModel`."""
    if model == ColorModel.HSV:
        return hsv_to_rgb(c)
    if model == ColorModel.HSL:
        return hsl_to_rgb(c)
    return c


@wp.func
def separate(model: int, c: wp.vec3) -> wp.vec3:
    """Three numbers of a `ColorModel` for the RGB colour `c`."""
    if model == ColorModel.HSV:
        return rgb_to_hsv(c)
    if model == ColorModel.HSL:
        return rgb_to_hsl(c)
    return c


@wp.func
def hue_saturation_value(hue: float, saturation: float, value: float, factor: float, color: wp.vec3) -> wp.vec3:
    """`color` with its hue turned by `hue` - 0.5 turns, and saturation and value multiplied.

    The result is mixed in by `factor`, and not below 0.
    """
    hsv = rgb_to_hsv(color)
    changed = hsv_to_rgb(wp.vec3(fraction(hsv[0] + hue + 0.5), saturated(hsv[1] * saturation), hsv[2] * value))
    mixed = factor * changed + (1.0 - factor) * color
    return wp.vec3(greater(mixed[0], 0.0), greater(mixed[1], 0.0), greater(mixed[2], 0.0))


@wp.func
def bright_contrast(color: wp.vec3, bright: float, contrast: float) -> wp.vec3:
    """`color`, brighter by `bright` and spread around 0.5 by 1 + `contrast`; not below 0."""
    slope = 1.0 + contrast
    offset = bright - contrast * 0.5
    r = greater(slope * color[0] + offset, 0.0)
    g = greater(slope * color[1] + offset, 0.0)
    b = greater(slope * color[2] + offset, 0.0)
    return wp.vec3(r, g, b)


@wp.func
def _power_channel(x: float, gamma: float) -> float:
    if x > 0.0:
        return wp.pow(x, gamma)
    return x


@wp.func
def gamma_color(color: wp.vec3, gamma: float) -> wp.vec3:
    """Channels above 0 to the power `gamma`, the others unchanged; white for `gamma` 0."""
    if gamma == 0.0:
        return wp.vec3(1.0, 1.0, 1.0)
    return wp.vec3(_power_channel(color[0], gamma), _power_channel(color[1], gamma), _power_channel(color[2], gamma))


@wp.func
def inverted(factor: float, color: wp.vec3) -> wp.vec3:
    """Mixture of `color` (factor 0) and 1 - `color` (factor 1)."""
    return factor * (wp.vec3(1.0, 1.0, 1.0) - color) + (1.0 - factor) * color


@op("combine_color", "innn>V")
@wp.func
def combine_color(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Color model, three numbers > colour."""
    c = wp.vec3(number(data, stack, pc + 2), number(data, stack, pc + 3), number(data, stack, pc + 4))
    put_vector(data, stack, pc + 5, combine(data.code[pc + 1], c))


@op("separate_color", "iv>NNN")
@wp.func
def separate_color(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Color model, colour > three numbers."""
    c = separate(data.code[pc + 1], vector(data, stack, pc + 2))
    put_number(data, stack, pc + 3, c[0])
    put_number(data, stack, pc + 4, c[1])
    put_number(data, stack, pc + 5, c[2])


@op("combine_xyz", "nnn>V")
@wp.func
def combine_xyz(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Three numbers > vector."""
    put_vector(
        data,
        stack,
        pc + 4,
        wp.vec3(number(data, stack, pc + 1), number(data, stack, pc + 2), number(data, stack, pc + 3)),
    )


@op("separate_xyz", "v>NNN")
@wp.func
def separate_xyz(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Vector > three numbers."""
    v = vector(data, stack, pc + 1)
    put_number(data, stack, pc + 2, v[0])
    put_number(data, stack, pc + 3, v[1])
    put_number(data, stack, pc + 4, v[2])


@op("hue_saturation", "nnnnv>V")
@wp.func
def hue_saturation(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Hue, saturation, value, factor, colour > colour."""
    hue = number(data, stack, pc + 1)
    saturation = number(data, stack, pc + 2)
    value = number(data, stack, pc + 3)
    factor = number(data, stack, pc + 4)
    put_vector(data, stack, pc + 6, hue_saturation_value(hue, saturation, value, factor, vector(data, stack, pc + 5)))


@op("bright_contrast", "vnn>V")
@wp.func
def bright_contrast_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Colour, brightness, contrast > colour."""
    color = vector(data, stack, pc + 1)
    put_vector(data, stack, pc + 4, bright_contrast(color, number(data, stack, pc + 2), number(data, stack, pc + 3)))


@op("gamma", "vn>V")
@wp.func
def gamma_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Colour, exponent > colour."""
    put_vector(data, stack, pc + 3, gamma_color(vector(data, stack, pc + 1), number(data, stack, pc + 2)))


@op("invert", "nv>V")
@wp.func
def invert_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Factor, colour > colour."""
    put_vector(data, stack, pc + 3, inverted(number(data, stack, pc + 1), vector(data, stack, pc + 2)))
