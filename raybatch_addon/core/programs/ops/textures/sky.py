"""Skies by direction, from coefficients of formulas or from pictures that `core/sky` has computed.

Directions need not be unit vectors where Blender does not require it either. Whatever they are, results are finite and
not negative.
"""

import warp as wp

from ....float32 import HALF_PI, TWO_PI
from ....shading.images.textures import Extension, ImageTable, Interpolation, sample_image
from ...op import NodeData, op, put_vector, vector
from ...point import ShadingPoint
from ..values.finite import finite_or_zero

# Offsets in the table of a formula
_PHI, _THETA, _RADIANCE, _SHAPE = 0, 1, 2, 5
SHAPE_COUNT = 9  # coefficients of a channel
# Offsets in the table of a scattering sky
_LOWEST, _HIGHEST, _ELEVATION, _AZIMUTH, _SIZE, _INTENSITY, _HORIZON = 0, 3, 6, 7, 8, 9, 10

# Least angle above the horizon at which formulas are evaluated; at the horizon they diverge [rad]
_HORIZON_MARGIN = wp.constant(0.001)
_LINEAR = wp.constant(int(Interpolation.LINEAR))
_EXTEND = wp.constant(int(Extension.EXTEND))
_LIMB = wp.constant(0.6)  # darkening of the sun's rim
# factor that brings Hosek and Wilkie's radiances to the scale of the others
_LUMINOUS = wp.constant(TWO_PI / 683.0)


@wp.func
def xyz_to_rgb(xyz: wp.vec3) -> wp.vec3:
    """Linear Rec. 709 (white D65 at 0.3127, 0.3290) of CIE XYZ.

    Channels below 0 are raised to it; numbers that are not finite become 0.
    """
    r = 3.2409699 * xyz[0] - 1.5373832 * xyz[1] - 0.4986108 * xyz[2]
    g = -0.9692436 * xyz[0] + 1.8759675 * xyz[1] + 0.0415551 * xyz[2]
    b = 0.0556301 * xyz[0] - 0.2039770 * xyz[1] + 1.0569715 * xyz[2]
    return wp.vec3(wp.max(finite_or_zero(r), 0.0), wp.max(finite_or_zero(g), 0.0), wp.max(finite_or_zero(b), 0.0))


@wp.func
def _finite(direction: wp.vec3) -> wp.vec3:
    return wp.vec3(finite_or_zero(direction[0]), finite_or_zero(direction[1]), finite_or_zero(direction[2]))


@wp.func
def _angles(direction: wp.vec3, table: wp.array(dtype=float), first: int) -> wp.vec2:
    """Angles of `direction` from the zenith, kept above the horizon, and from the sun [rad]."""
    theta = wp.acos(wp.clamp(direction[2], -1.0, 1.0))
    phi = HALF_PI - wp.atan2(direction[1], direction[0])
    sun_phi = table[first + wp.static(_PHI)]
    sun_theta = table[first + wp.static(_THETA)]
    cosine = wp.sin(theta) * wp.sin(sun_theta) * wp.cos(sun_phi - phi) + wp.cos(theta) * wp.cos(sun_theta)
    gamma = wp.acos(wp.clamp(cosine, -1.0, 1.0))
    return wp.vec2(wp.min(theta, HALF_PI - _HORIZON_MARGIN), gamma)


@wp.func
def preetham_sky(table: wp.array(dtype=float), first: int, direction: wp.vec3) -> wp.vec3:
    """RGB of the sky of Preetham, Shirley and Smits, "A Practical Analytic Model for Daylight" (SIGGRAPH 1999).

    `table` from `first` on: `core/sky/preetham.py`.
    """
    angles = _angles(_finite(direction), table, first)
    cos_theta = wp.cos(angles[0])
    gamma = angles[1]
    cos_gamma = wp.cos(gamma)
    value = wp.vec3()  # Y, x, y
    for k in range(3):
        c = first + wp.static(_SHAPE) + k * wp.static(SHAPE_COUNT)
        rise = 1.0 + table[c] * wp.exp(table[c + 1] / cos_theta)
        glow = 1.0 + table[c + 2] * wp.exp(table[c + 3] * gamma) + table[c + 4] * cos_gamma * cos_gamma
        value[k] = table[first + wp.static(_RADIANCE) + k] * (rise * glow)
    xyz = wp.vec3(0.0, value[0], 0.0)
    if value[2] != 0.0:
        xyz[0] = (value[1] / value[2]) * value[0]
        if value[0] != 0.0:
            xyz[2] = (1.0 - value[1] - value[2]) / value[2] * value[0]
    return xyz_to_rgb(xyz)


@wp.func
def hosek_wilkie_sky(table: wp.array(dtype=float), first: int, direction: wp.vec3) -> wp.vec3:
    """RGB of the sky of Hosek and Wilkie, "An Analytic Model for Full Spectral Sky-Dome Radiance" (SIGGRAPH 2012).

    `table` from `first` on: `core/sky/hosek_wilkie.py`.
    """
    angles = _angles(_finite(direction), table, first)
    cos_theta = wp.cos(angles[0])
    gamma = angles[1]
    cos_gamma = wp.cos(gamma)
    rayleigh = cos_gamma * cos_gamma
    zenith = wp.sqrt(wp.max(cos_theta, 0.0))
    xyz = wp.vec3()
    for k in range(3):
        c = first + wp.static(_SHAPE) + k * wp.static(SHAPE_COUNT)
        g = table[c + 8]
        mie = (1.0 + rayleigh) / wp.pow(wp.max(1.0 + g * g - 2.0 * g * cos_gamma, 0.0), 1.5)
        rise = 1.0 + table[c] * wp.exp(table[c + 1] / (cos_theta + 0.01))
        glow = (
            table[c + 2]
            + table[c + 3] * wp.exp(table[c + 4] * gamma)
            + table[c + 5] * rayleigh
            + table[c + 6] * mie
            + table[c + 7] * zenith
        )
        xyz[k] = rise * glow * table[first + wp.static(_RADIANCE) + k]
    return _LUMINOUS * xyz_to_rgb(xyz)


@wp.func
def scattering_sky(
    images: ImageTable, picture: int, table: wp.array(dtype=float), first: int, direction: wp.vec3
) -> wp.vec3:
    """RGB of a sky whose picture is image `picture`, in CIE XYZ, with the sun's disc.

    `table` from `first` on: `core/sky/atmosphere.py`, `sky_table`. The sun's limb darkens to 0.4; the sun is seen above
    the horizon alone.
    """
    d = _finite(direction)
    elevation = HALF_PI - wp.acos(wp.clamp(d[2], -1.0, 1.0))
    azimuth = wp.atan2(d[1], d[0])
    sun_elevation = table[first + wp.static(_ELEVATION)]
    sun_azimuth = table[first + wp.static(_AZIMUTH)]
    size = table[first + wp.static(_SIZE)]
    xyz = wp.vec3()
    if size > 0.0 and elevation > table[first + wp.static(_HORIZON)]:
        # rounded as in Blender: the angle from a small sun's middle shows it
        theta = sun_elevation - HALF_PI
        phi = sun_azimuth - HALF_PI
        sun = wp.vec3(wp.sin(theta) * wp.cos(phi), wp.sin(theta) * wp.sin(phi), wp.cos(theta))
        from_middle = 2.0 * wp.atan2(wp.length(d - sun), wp.length(d + sun)) / (0.5 * size)
        if from_middle < 1.0:
            height = (elevation - sun_elevation) / size + 0.5
            limb = 1.0 - _LIMB * (1.0 - wp.sqrt(1.0 - from_middle * from_middle))
            for k in range(3):
                lowest = table[first + wp.static(_LOWEST) + k]
                xyz[k] = (
                    (lowest + height * (table[first + wp.static(_HIGHEST) + k] - lowest))
                    * table[first + wp.static(_INTENSITY)]
                    * limb
                )
    turns = (sun_azimuth - azimuth - HALF_PI) / TWO_PI
    row = wp.sqrt(wp.abs(elevation) / HALF_PI)
    uv = wp.vec2(turns - wp.floor(turns), wp.where(elevation < 0.0, -row, row) * 0.5 + 0.5)
    found = sample_image(images, picture, uv, _LINEAR, _EXTEND, 0)
    return xyz_to_rgb(xyz + wp.vec3(found[0], found[1], found[2]))


@op("sky_preetham", "tv>V", foldable=False)
@wp.func
def _preetham(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    put_vector(data, stack, pc + 3, preetham_sky(data.constants, data.code[pc + 1], vector(data, stack, pc + 2)))


@op("sky_hosek_wilkie", "tv>V", foldable=False)
@wp.func
def _hosek_wilkie(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    put_vector(data, stack, pc + 3, hosek_wilkie_sky(data.constants, data.code[pc + 1], vector(data, stack, pc + 2)))


@op("sky_scattering", "mtv>V", foldable=False)
@wp.func
def _scattering(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    direction = vector(data, stack, pc + 3)
    put_vector(
        data,
        stack,
        pc + 4,
        scattering_sky(data.images, data.code[pc + 1], data.constants, data.code[pc + 2], direction),
    )
