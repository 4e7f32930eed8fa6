"""A sky of light that air and aerosols of a city scatter many times, with ozone that absorbs.

Fernando García Liñán, "Spectral sky rendering" (2024, https://fgarlin.com/posts/2024-12-06-spectral_sky, MIT licence).
Four wavelengths are enough with fitted colours; light scattered more than once is a fit that includes light from the
ground. Numbers are float32 and sums in one order, since pictures are to be those of Blender.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..device.bulk import in_slices
from .atmosphere import PICTURE_WIDTH, Atmosphere, F, SkyModel, SunDisc, in_parts
from .scattering_kernels import (
    AEROSOL_ABSORPTION,
    AEROSOL_BACKGROUND,
    AEROSOL_DENSITY,
    AEROSOL_HEIGHT,
    AEROSOL_SCATTERING,
    AIR_SCATTERING,
    EARTH,
    IRRADIANCE,
    LIGHT_HEIGHT,
    LIGHT_WIDTH,
    OZONE_ABSORPTION,
    OZONE_AMOUNT,
    SEGMENTS,
    THICKNESS,
    TO_XYZ,
    TOP,
    SkyWork,
    lit_kernel,
    load_sky_kernels,
    scattered_kernel,
)

_ALTITUDE_RANGE = (1.0, 99999.0)  # [m]
_ROWS_AT_ONCE = 8  # of the table


@functools.lru_cache(maxsize=4)
def multiple_scattering_picture(atmosphere: Atmosphere) -> np.ndarray:
    """Radiance of the sky, and of the air in front of the ground; see `atmosphere.py` for its layout. Read only."""
    lit = _lit_table(atmosphere.air, atmosphere.aerosol, atmosphere.ozone)
    cosine = np.cos(F(0.5 * math.pi) - F(atmosphere.sun_elevation))
    sun = wp.vec3(*(float(each) for each in _sun_direction(cosine)))
    start = float(EARTH + F(np.clip(atmosphere.altitude, *_ALTITUDE_RANGE)) / F(1000))

    def render(rows: np.ndarray) -> np.ndarray:
        half = np.empty((len(rows), PICTURE_WIDTH // 2, 3), F)
        work = _work(atmosphere, lit, int(rows[0]))
        work.sun, work.start, work.picture = sun, start, wp.array(half, dtype=wp.vec3, device="cpu", copy=False)
        wp.launch(scattered_kernel, half.shape[0] * half.shape[1], [work], device="cpu")
        return half

    picture = in_parts(0, render)
    picture.flags.writeable = False
    return picture


def multiple_scattering_disc(atmosphere: Atmosphere, size: float) -> SunDisc:
    """The sun's disc of angular diameter `size` [rad]."""
    solid_angle = F(2 * math.pi) * (F(1) - np.cos(F(size) / F(2)))
    height = F(np.clip(atmosphere.altitude, *_ALTITUDE_RANGE)) / F(1000)

    def color(elevation: np.float32) -> tuple[float, float, float]:
        cosine = np.array([np.cos(F(0.5 * math.pi) - elevation)], F)
        passed = _transmittance(cosine, np.array([height / THICKNESS], F), atmosphere)
        x, y, z = _to_xyz(IRRADIANCE * passed / solid_angle)[0]
        return float(x), float(y), float(z)

    half = F(size) / F(2)
    return SunDisc(color(F(atmosphere.sun_elevation) - half), color(F(atmosphere.sun_elevation) + half))


MULTIPLE_SCATTERING = SkyModel(multiple_scattering_picture, multiple_scattering_disc)


def _work(atmosphere: Atmosphere, lit: wp.array, row_first: int) -> SkyWork:
    work = SkyWork()
    work.air, work.aerosol, work.ozone = atmosphere.air, atmosphere.aerosol, atmosphere.ozone
    work.lit, work.row_first = lit, row_first
    return work


def _sun_direction(cosine):
    return -np.sqrt(F(1) - cosine * cosine), np.zeros_like(cosine), cosine


def _to_xyz(spectrum: np.ndarray) -> np.ndarray:
    result = np.zeros((*spectrum.shape[:-1], 3), F)
    for i, color in enumerate(TO_XYZ):
        result += color * spectrum[..., i, None]
    return result


def _length(x, y, z):
    return np.sqrt(x * x + y * y + z * z)


def _to_sphere(z0, direction, radius) -> np.ndarray:
    """Distance from (0, 0, z0) to a sphere around the origin [km]; -1 if the ray misses it."""
    along = z0 * direction[2]
    outside = z0 * z0 - radius * radius
    rest = along * along - outside
    root = np.sqrt(np.maximum(rest, F(0)))
    distance = np.where(rest >= along * along, root - along, -root - along)
    return np.where((rest < 0) | ((outside > 0) & (along > 0)), F(-1), distance)


def _rounded(function: np.ufunc, *arguments) -> np.ndarray:
    """`function` rounded to the nearest float32.

    Light lost on a short way is all in the last bit, and NumPy's float32 functions err more.
    """
    return function(*(np.asarray(each, np.float64) for each in arguments)).astype(F)


@dataclass(frozen=True)
class _Coefficients:
    """Effects of air and aerosols on light at some altitudes [1 / km], [..., 4]."""

    air: np.ndarray  # scattering
    aerosol: np.ndarray  # scattering
    extinction: np.ndarray  # scattering and absorption together


def _coefficients(altitude: np.ndarray, atmosphere: Atmosphere) -> _Coefficients:
    """Coefficients at `altitude` [km], at least 0."""
    share = _rounded(np.exp, -altitude / AEROSOL_HEIGHT) + AEROSOL_BACKGROUND / AEROSOL_DENSITY
    density = (AEROSOL_DENSITY * share * F(atmosphere.aerosol))[..., None]
    height = _rounded(np.log, np.maximum(altitude, F(1e-4)))
    from_peak = height - F(3.22261)
    ozone = F(3.78547397e20) * _rounded(np.exp, -(from_peak * from_peak) * F(5.55555555) - height)
    ozone_absorption = OZONE_ABSORPTION * OZONE_AMOUNT * ozone[..., None] * F(atmosphere.ozone)
    thin = _rounded(np.exp, F(-0.07771971) * _rounded(np.power, altitude, F(1.16364243)))
    air = AIR_SCATTERING * thin[..., None] * F(atmosphere.air)
    aerosol = AEROSOL_SCATTERING * density
    return _Coefficients(air, aerosol, AEROSOL_ABSORPTION * density + aerosol + ozone_absorption + air)


def _transmittance(cosine: np.ndarray, height: np.ndarray, atmosphere: Atmosphere) -> np.ndarray:
    """Share of sunlight at `height` (0: ground, 1: top) when the sun's zenith angle has `cosine`: [..., 4]."""
    x, _, z = _sun_direction(cosine)
    start = EARTH + height * (TOP - EARTH)
    step = _to_sphere(start, (x, None, z), TOP) / F(SEGMENTS)
    depth = np.zeros((*cosine.shape, 4), F)
    for i in range(SEGMENTS):
        t = (F(i) + F(0.5)) * step
        altitude = np.maximum(_length(x * t, F(0), start + z * t) - EARTH, F(0))
        depth += _coefficients(altitude, atmosphere).extinction * step[..., None]
    return _rounded(np.exp, -depth)


@functools.lru_cache(maxsize=4)
def _lit_table(air: float, aerosol: float, ozone: float) -> wp.array:
    """`_transmittance` by height and cosine: vec4, shape [LIGHT_HEIGHT, LIGHT_WIDTH], on the CPU."""
    load_sky_kernels()
    table = wp.empty((LIGHT_HEIGHT, LIGHT_WIDTH), dtype=wp.vec4, device="cpu")
    atmosphere = Atmosphere(0.0, 0.0, air, aerosol, ozone)

    def part(rows: slice) -> None:
        count = (rows.stop - rows.start) * LIGHT_WIDTH
        wp.launch(lit_kernel, count, [_work(atmosphere, table, rows.start)], device="cpu")

    in_slices(LIGHT_HEIGHT, part, _ROWS_AT_ONCE)
    return table
