"""The integrals of `multiple_scattering.py` for its table and its picture, as kernels for a CPU: NumPy takes four times
as long. Numbers are float32, in the order of Blender's sums.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from ..device.devices import load_module, start_warp
from ..device.kernel import KERNEL_OPTIONS
from .atmosphere import EARTH_RADIUS, PICTURE_HEIGHT, PICTURE_WIDTH, F

SEGMENTS = 64  # of any ray
LIGHT_WIDTH, LIGHT_HEIGHT = 256, 64  # table of transmittances to the sun, by cosine of its zenith angle and altitude
EARTH = F(EARTH_RADIUS)  # [km]
THICKNESS = F(100.0)  # thickness of the atmosphere [km]
TOP = EARTH + THICKNESS
GROUND = F(0.3)  # share of light that the ground reflects
FORWARD = F(0.8)  # asymmetry of scattering by aerosols

# at 630, 560, 490 and 430 nm
IRRADIANCE = np.array([1.679, 1.828, 1.986, 1.307], F)  # sunlight outside the atmosphere [W / (m^2 nm)]
AIR_SCATTERING = np.array([6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2], F)  # at sea level [1 / km]
OZONE_ABSORPTION = np.array([3.472e-25, 3.914e-25, 1.349e-25, 11.03e-27], F)  # cross section [m^2]
OZONE_AMOUNT = F(334.5)  # [Dobson units]
AEROSOL_ABSORPTION = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23], F)  # cross section [m^2]
AEROSOL_SCATTERING = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22], F)  # cross section [m^2]
AEROSOL_DENSITY = F(1.3681e20)  # number density at sea level
AEROSOL_BACKGROUND = F(2e6)  # number density everywhere
AEROSOL_HEIGHT = F(0.73)  # height at which the density is 1 / e of that at sea level [km]
REPEATED = np.array([0.217, 0.347, 0.594, 1.0], F)  # light that air has scattered more than once
# XYZ of light of each of the four wavelengths
TO_XYZ = np.array(
    [
        (53.386917738564668023, 22.981337506691024754, 0.0),
        (43.904844466369358263, 71.347795700053393866, 0.102506867965741307),
        (1.6137278251608962005, 18.422960591455485011, 31.742921188390805758),
        (20.762668673810577145, 2.3614213523314368527, 110.48009643252140334),
    ],
    F,
)


def _four(values: np.ndarray) -> wp.vec4:
    return wp.vec4(*(float(each) for each in values))


def _three(wavelength: int) -> wp.vec3:
    return wp.vec3(*(float(each) for each in TO_XYZ[wavelength]))


@wp.struct
class SkyWork:
    """An atmosphere, and what is computed of it."""

    air: float  # densities, as of `Atmosphere`
    aerosol: float
    ozone: float
    sun: wp.vec3  # unit direction towards it, +Z up
    start: float  # distance of the viewer from the Earth's centre [km]
    lit: wp.array2d(dtype=wp.vec4)  # share of sunlight by height and cosine, shape [LIGHT_HEIGHT, LIGHT_WIDTH]
    row_first: int  # of the picture or table that item 0 belongs to
    picture: wp.array2d(dtype=wp.vec3)  # XYZ of rows from `row_first` on, shape [rows, PICTURE_WIDTH / 2]


@wp.struct
class _Coefficients:
    """Effects of air and aerosols on light at an altitude [1 / km]."""

    air: wp.vec4  # scattering
    aerosol: wp.vec4  # scattering
    extinction: wp.vec4  # scattering and absorption together


@wp.func
def _coefficients(work: SkyWork, altitude: float) -> _Coefficients:
    share = wp.exp(-altitude / wp.static(float(AEROSOL_HEIGHT))) + wp.static(
        float(AEROSOL_BACKGROUND / AEROSOL_DENSITY)
    )
    density = wp.static(float(AEROSOL_DENSITY)) * share * work.aerosol
    height = wp.log(wp.max(altitude, 1e-4))
    from_peak = height - 3.22261
    ozone = 3.78547397e20 * wp.exp(-(from_peak * from_peak) * 5.55555555 - height)
    thin = wp.exp(-0.07771971 * wp.pow(altitude, 1.16364243))
    found = _Coefficients()
    found.air = wp.static(_four(AIR_SCATTERING)) * thin * work.air
    found.aerosol = wp.static(_four(AEROSOL_SCATTERING)) * density
    absorbed = wp.static(_four(OZONE_ABSORPTION * OZONE_AMOUNT)) * ozone * work.ozone
    found.extinction = wp.static(_four(AEROSOL_ABSORPTION)) * density + found.aerosol + absorbed + found.air
    return found


@wp.func
def _to_sphere(z0: float, z: float, radius: float) -> float:
    """Distance from (0, 0, z0) to a sphere around the origin [km]; -1 if the ray misses it."""
    along = z0 * z
    outside = z0 * z0 - radius * radius
    rest = along * along - outside
    if rest < 0.0 or (outside > 0.0 and along > 0.0):
        return -1.0
    root = wp.sqrt(rest)
    return wp.where(rest >= along * along, root - along, -root - along)


@wp.func
def _exp(values: wp.vec4) -> wp.vec4:
    return wp.vec4(wp.exp(values[0]), wp.exp(values[1]), wp.exp(values[2]), wp.exp(values[3]))


@wp.kernel(**KERNEL_OPTIONS)
def lit_kernel(work: SkyWork):
    """Share of sunlight that comes to a height, where the sun's zenith angle has a cosine."""
    i = wp.tid()
    row = work.row_first + i / wp.static(LIGHT_WIDTH)
    column = i % wp.static(LIGHT_WIDTH)
    z = float(column) / wp.static(float(LIGHT_WIDTH - 1)) * 2.0 - 1.0
    x = -wp.sqrt(1.0 - z * z)
    height = float(row) / wp.static(float(LIGHT_HEIGHT - 1))
    start = wp.static(float(EARTH)) + height * wp.static(float(TOP - EARTH))
    step = _to_sphere(start, z, wp.static(float(TOP))) / wp.static(float(SEGMENTS))
    depth = wp.vec4(0.0)
    segments = int(SEGMENTS)
    for k in range(segments):
        t = (float(k) + 0.5) * step
        altitude = wp.sqrt(x * t * (x * t) + (start + z * t) * (start + z * t)) - wp.static(float(EARTH))
        depth += _coefficients(work, wp.max(altitude, 0.0)).extinction * step
    work.lit[row, column] = _exp(-depth)


@wp.func
def _lit(work: SkyWork, column: float, height: float) -> wp.vec4:
    """Transmittance to the sun at a column of the table and at `height`."""
    row = wp.static(float(LIGHT_HEIGHT - 1)) * wp.clamp(height, 0.0, 1.0)
    low = int(row)
    high = wp.min(low + 1, wp.static(LIGHT_HEIGHT - 1))
    left = int(column)
    right = wp.min(left + 1, wp.static(LIGHT_WIDTH - 1))
    share = column - float(left)
    below = work.lit[low, left] + share * (work.lit[low, right] - work.lit[low, left])
    above = work.lit[high, left] + share * (work.lit[high, right] - work.lit[high, left])
    return below + (row - float(low)) * (above - below)


@wp.func
def _repeated(work: SkyWork, cosine: float, column: float, height: float, from_centre: float) -> wp.vec4:
    """Light that was scattered more than once, by air (a fit) and by the ground, for a unit of sunlight."""
    ratio = wp.static(float(EARTH)) / from_centre
    # solid angle of the Earth
    angle = wp.static(float(F(2 * math.pi))) * (1.0 - wp.sqrt(wp.max(1.0 - ratio * ratio, 0.0)))
    to_ground = _lit(work, column, 0.0)
    last = wp.static(float(LIGHT_WIDTH - 1))
    from_ground = wp.cw_div(work.lit[0, wp.static(LIGHT_WIDTH - 1)], _lit(work, last, height))
    share = wp.static(float(F(0.25 / math.pi))) * angle * wp.static(float(GROUND * F(1 / math.pi)))
    ground = wp.cw_mul(share * to_ground, from_ground) * cosine
    air = 0.02 * wp.static(_four(REPEATED)) * (1.0 / (1.0 + 5.0 * wp.exp(-17.92 * cosine)))
    return air + ground


@wp.kernel(**KERNEL_OPTIONS)
def scattered_kernel(work: SkyWork):
    """Light from a direction to the viewer."""
    i = wp.tid()
    row = i / wp.static(PICTURE_WIDTH // 2)
    column = i % wp.static(PICTURE_WIDTH // 2)
    v = (float(work.row_first + row) + 0.5) / wp.static(float(PICTURE_HEIGHT)) * 2.0 - 1.0
    elevation = wp.where(v < 0.0, -v * v, v * v) * wp.static(float(F(0.5 * math.pi)))
    azimuth = wp.static(float(F(2 * math.pi))) * ((float(column) + 0.5) / wp.static(float(PICTURE_WIDTH)))
    flat = wp.cos(elevation)
    d = wp.vec3(flat * wp.cos(azimuth), flat * wp.sin(azimuth), wp.sin(elevation))
    length = _to_sphere(work.start, d[2], wp.static(float(EARTH)))
    if length < 0.0:
        length = _to_sphere(work.start, d[2], wp.static(float(TOP)))
    step = length / wp.static(float(SEGMENTS))
    cosine = -d[0] * work.sun[0] + -d[1] * work.sun[1] + -d[2] * work.sun[2]
    air_phase = wp.static(float(F(3.0 / 16.0 / math.pi))) * (1.0 + cosine * cosine)
    spread = wp.static(float(F(1) + FORWARD * FORWARD)) + wp.static(float(F(2) * FORWARD)) * cosine
    aerosol_phase = wp.static(float(F(0.25 / math.pi) * (F(1) - FORWARD * FORWARD))) / (spread * wp.sqrt(spread))
    light = wp.vec4(0.0)
    passed = wp.vec4(1.0)
    segments = int(SEGMENTS)
    for k in range(segments):
        t = (float(k) + 0.5) * step
        p = wp.vec3(d[0] * t, d[1] * t, work.start + d[2] * t)
        from_centre = wp.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        altitude = wp.max(from_centre - wp.static(float(EARTH)), 0.0)
        height = altitude / wp.static(float(THICKNESS))
        up = p / from_centre
        sun_cosine = up[0] * work.sun[0] + up[1] * work.sun[1] + up[2] * work.sun[2]
        at = wp.static(float(LIGHT_WIDTH - 1)) * wp.clamp(sun_cosine * 0.5 + 0.5, 0.0, 1.0)
        here = _coefficients(work, altitude)
        lit = _lit(work, at, height)
        repeated = _repeated(work, sun_cosine, at, height, from_centre)
        source = wp.cw_mul(here.air, air_phase * lit + repeated) + wp.cw_mul(
            here.aerosol, aerosol_phase * lit + repeated
        )
        source = wp.cw_mul(wp.static(_four(IRRADIANCE)), source)
        kept = _exp(-step * here.extinction)
        least = wp.max(here.extinction, wp.vec4(1e-7))
        light += wp.cw_mul(passed, wp.cw_div(source - wp.cw_mul(source, kept), least))
        passed = wp.cw_mul(passed, kept)
    xyz = wp.static(_three(0)) * light[0] + wp.static(_three(1)) * light[1]
    work.picture[row, column] = xyz + wp.static(_three(2)) * light[2] + wp.static(_three(3)) * light[3]


SKY_KERNELS = (lit_kernel, scattered_kernel)  # for the CPU alone


def load_sky_kernels() -> None:
    """Make the kernels ready to be launched, by any thread."""
    start_warp()
    for kernel in SKY_KERNELS:
        load_module(kernel, wp.get_device("cpu"))
