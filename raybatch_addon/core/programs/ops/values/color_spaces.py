"""Colours as hue, saturation and value or lightness, the hue in turns.

Linear RGB beyond [0, 1] is allowed. Formulas and their branches are those of Blender's renderers, as pictures depend on
them there.
"""

import warp as wp

from .math import lesser, limited


@wp.func
def _highest(c: wp.vec3) -> float:
    return wp.max(c[0], wp.max(c[1], c[2]))


@wp.func
def _lowest(c: wp.vec3) -> float:
    return lesser(c[0], lesser(c[1], c[2]))


@wp.func
def rgb_to_hsv(c: wp.vec3) -> wp.vec3:
    """Hue [turns], saturation, value of RGB; hue 0 for greys, saturation 0 for black."""
    highest = _highest(c)
    chroma = highest - _lowest(c)
    saturation = float(0.0)
    hue = float(0.0)
    if highest != 0.0:
        saturation = chroma / highest
    if saturation != 0.0:
        r = (highest - c[0]) / chroma
        g = (highest - c[1]) / chroma
        b = (highest - c[2]) / chroma
        if c[0] == highest:
            hue = b - g
        elif c[1] == highest:
            hue = 2.0 + r - b
        else:
            hue = 4.0 + g - r
        hue = hue / 6.0
        if hue < 0.0:
            hue = hue + 1.0
    return wp.vec3(hue, saturation, highest)


@wp.func
def hsv_to_rgb(c: wp.vec3) -> wp.vec3:
    """RGB of hue [turns], saturation, value; a hue beyond [0, 1] counts as in the last sixth of the circle."""
    hue = c[0]
    saturation = c[1]
    value = c[2]
    if saturation == 0.0:
        return wp.vec3(value, value, value)
    if hue == 1.0:
        hue = 0.0
    sixth = wp.floor(hue * 6.0)
    f = hue * 6.0 - sixth
    p = value * (1.0 - saturation)
    q = value * (1.0 - saturation * f)
    t = value * (1.0 - saturation * (1.0 - f))
    if sixth == 0.0:
        return wp.vec3(value, t, p)
    if sixth == 1.0:
        return wp.vec3(q, value, p)
    if sixth == 2.0:
        return wp.vec3(p, value, t)
    if sixth == 3.0:
        return wp.vec3(p, q, value)
    if sixth == 4.0:
        return wp.vec3(t, p, value)
    return wp.vec3(value, p, q)


@wp.func
def rgb_to_hsl(c: wp.vec3) -> wp.vec3:
    """Hue [turns], saturation, lightness (at most 1) of RGB; hue and saturation 0 for greys."""
    highest = _highest(c)
    lowest = _lowest(c)
    lightness = lesser(1.0, (highest + lowest) / 2.0)
    chroma = highest - lowest
    if chroma == 0.0:
        return wp.vec3(0.0, 0.0, lightness)
    span = highest + lowest
    if lightness > 0.5:
        span = 2.0 - highest - lowest
    saturation = float(0.0)
    if span != 0.0:
        saturation = chroma / span
    hue = float(0.0)
    if c[0] == highest:
        hue = (c[1] - c[2]) / chroma
        if c[1] < c[2]:
            hue = hue + 6.0
    elif c[1] == highest:
        hue = (c[2] - c[0]) / chroma + 2.0
    else:
        hue = (c[0] - c[1]) / chroma + 4.0
    return wp.vec3(hue / 6.0, saturation, lightness)


@wp.func
def hsl_to_rgb(c: wp.vec3) -> wp.vec3:
    """RGB of hue [turns], saturation, lightness."""
    hue = c[0] * 6.0
    r = limited(wp.abs(hue - 3.0) - 1.0, 0.0, 1.0)
    g = limited(2.0 - wp.abs(hue - 2.0), 0.0, 1.0)
    b = limited(2.0 - wp.abs(hue - 4.0), 0.0, 1.0)
    chroma = (1.0 - wp.abs(2.0 * c[2] - 1.0)) * c[1]
    return wp.vec3((r - 0.5) * chroma + c[2], (g - 0.5) * chroma + c[2], (b - 0.5) * chroma + c[2])
