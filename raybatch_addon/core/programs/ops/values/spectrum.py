"""Colours of glowing bodies and of single wavelengths, in linear Rec. 709.

Their numbers are tables among the constants of programs, so that no kernel holds them.
"""

import numpy as np
import warp as wp

from ....shading.bsdf.color_matching import XYZ_TO_REC709, matching_functions
from ...op import NodeData, number, op, put_number, put_vector
from ...point import ShadingPoint
from .math import greater, safe_divide

_BRIGHTEST = 2.52  # scale that brings the highest channel of all wavelengths to about 1
WAVELENGTH_FIRST = 380.0  # [nm]
WAVELENGTH_STEP = 5.0  # [nm]
WAVELENGTH_COUNT = 81

# Light of a black body of luminance 1 at temperatures t [K]: a fit by pieces. Each has its first temperature; a, b, c
# of a/t + b t + c for red and for green; a, b, c, d of ((a t + b) t + c) t + d for blue. The numbers are those of
# Cycles (Apache-2.0), whose pictures are to be met.
_BLACKBODY = (
    (
        800,
        1.61919106e3,
        -2.05010916e-3,
        5.02995757,
        -4.88999748e2,
        6.04330754e-4,
        -7.55807526e-2,
        5.96945309e-11,
        -4.85742887e-8,
        -9.70622247e-5,
        -4.07936148e-3,
    ),
    (
        965,
        2.48845471e3,
        -1.11330907e-3,
        3.22621544,
        -7.55994277e2,
        3.16730098e-4,
        4.78306139e-1,
        2.40430366e-11,
        5.55021075e-8,
        -1.98503712e-4,
        2.89312858e-2,
    ),
    (
        1167,
        3.34143193e3,
        -4.86551192e-4,
        1.76486769,
        -1.02363977e3,
        1.20223470e-4,
        9.36662319e-1,
        -1.40949732e-11,
        1.89878968e-7,
        -3.56632824e-4,
        9.10767778e-2,
    ),
    (
        1449,
        4.09461742e3,
        -1.27446582e-4,
        7.25731635e-1,
        -1.26571316e3,
        4.87340896e-6,
        1.27054498,
        -3.61460868e-11,
        2.84822009e-7,
        -4.93211319e-4,
        1.56723440e-1,
    ),
    (
        1902,
        4.67028036e3,
        2.91258199e-5,
        1.26703442e-1,
        -1.42529332e3,
        -4.01150431e-5,
        1.43972784,
        -1.97075738e-11,
        1.75359352e-7,
        -2.50542825e-4,
        -2.22783266e-2,
    ),
    (
        3315,
        4.59509185e3,
        2.87495649e-5,
        1.50345020e-1,
        -1.17554822e3,
        -2.16378048e-5,
        1.30408023,
        -1.61997957e-13,
        -1.64216008e-8,
        3.86216271e-4,
        -7.38077418e-1,
    ),
    (
        6365,
        3.78717450e3,
        9.35907826e-6,
        3.99075871e-1,
        -5.00799571e2,
        -4.59832026e-6,
        1.09098763,
        6.72650283e-13,
        -2.73078809e-8,
        4.24098264e-4,
        -7.52335691e-1,
    ),
)
# the fit is for a white that is rounded otherwise
_FIT_TO_REC709 = (1.00015915, 0.99997692, 0.99976005)
BLACKBODY_PIECES = len(_BLACKBODY)
BLACKBODY_WIDTH = len(_BLACKBODY[0])
COLDEST, HOTTEST = 800.0, 12000.0  # [K]; beyond, the colour does not change
INFINITELY_FAR = 3.0e38  # [m]


def wavelength_table() -> list[float]:
    """Table of the op `wavelength`: RGB of each wavelength, channels below 0 included."""
    return (matching_functions() @ np.array(XYZ_TO_REC709).T / _BRIGHTEST).ravel().tolist()


def blackbody_table() -> list[float]:
    """Table of the op `blackbody`: the pieces of its fit."""
    red, green, blue = _FIT_TO_REC709
    scales = (1.0, red, red, red, green, green, green, blue, blue, blue, blue)
    return [x * scale for piece in _BLACKBODY for x, scale in zip(piece, scales)]


@wp.func
def wavelength_color(constants: wp.array(dtype=float), first: int, wavelength: float) -> wp.vec3:
    """Linear RGB of light of `wavelength` [nm], no channel below 0; black where the eye sees none."""
    position = (wavelength - WAVELENGTH_FIRST) / WAVELENGTH_STEP
    if not (position > -1.0 and position < float(WAVELENGTH_COUNT - 1)):  # NaN too
        return wp.vec3(0.0, 0.0, 0.0)
    i = int(position)  # rounded towards 0: the first step goes on below 380 nm
    t = position - float(i)
    color = wp.vec3(0.0, 0.0, 0.0)
    count = int(3)
    for c in range(count):
        here = constants[first + 3 * i + c]
        color[c] = greater(here + t * (constants[first + 3 * i + 3 + c] - here), 0.0)
    return color


@wp.func
def blackbody_color(constants: wp.array(dtype=float), first: int, temperature: float) -> wp.vec3:
    """Linear RGB of a black body of `temperature` [K] and luminance 1, no channel below 0."""
    if temperature >= HOTTEST:
        return wp.vec3(0.826426988, 0.994485096, 1.565931871)
    if temperature < COLDEST:
        return wp.vec3(5.414156016, 0.0, 0.0)
    at = int(first)
    for piece in range(1, BLACKBODY_PIECES):
        if temperature >= constants[first + piece * BLACKBODY_WIDTH]:
            at = first + piece * BLACKBODY_WIDTH
    inverse = safe_divide(1.0, temperature)
    red = constants[at + 1] * inverse + constants[at + 2] * temperature + constants[at + 3]
    green = constants[at + 4] * inverse + constants[at + 5] * temperature + constants[at + 6]
    blue = (
        (constants[at + 7] * temperature + constants[at + 8]) * temperature + constants[at + 9]
    ) * temperature + constants[at + 10]
    return wp.vec3(greater(red, 0.0), greater(green, 0.0), greater(blue, 0.0))


@op("wavelength", "nt>V")
@wp.func
def wavelength_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Wavelength [nm], table > colour."""
    put_vector(data, stack, pc + 3, wavelength_color(data.constants, data.code[pc + 2], number(data, stack, pc + 1)))


@op("blackbody", "nt>V")
@wp.func
def blackbody_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Temperature [K], table > colour."""
    put_vector(data, stack, pc + 3, blackbody_color(data.constants, data.code[pc + 2], number(data, stack, pc + 1)))


@op("light_falloff", "nn>NNN", foldable=False)
@wp.func
def light_falloff(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Light falloff: strength, smoothing [m²] > three strengths.

    They fall with the square of the distance, with the distance, and not at all.
    """
    strength = number(data, stack, pc + 1)
    smooth = number(data, stack, pc + 2)
    length = point.ray_length
    # light from infinitely far does not fall
    if not (length < INFINITELY_FAR):
        length = 1.0
        smooth = 0.0
    squared = length * length
    if smooth > 0.0:
        strength = strength * squared / (smooth + squared)
    put_number(data, stack, pc + 3, strength)
    put_number(data, stack, pc + 4, strength * length)
    put_number(data, stack, pc + 5, strength * squared)
