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

from .atmosphere import EARTH_RADIUS, PICTURE_HEIGHT, PICTURE_WIDTH, Atmosphere, F, SkyModel, SunDisc, in_parts

ALTITUDE_RANGE = (1.0, 99999.0)  # [m]
_EARTH = F(EARTH_RADIUS)  # [km]
_THICKNESS = F(100.0)  # thickness of the atmosphere [km]
_TOP = _EARTH + _THICKNESS
_SEGMENTS = 64  # segments of any ray
_LIGHT_WIDTH, _LIGHT_HEIGHT = 256, 64  # table of transmittances to the sun, by cosine of its zenith angle and altitude
_GROUND = F(0.3)  # share of light that the ground reflects
_FORWARD = F(0.8)  # asymmetry of scattering by aerosols

# at 630, 560, 490 and 430 nm
_IRRADIANCE = np.array([1.679, 1.828, 1.986, 1.307], F)  # sunlight outside the atmosphere [W / (m^2 nm)]
_AIR_SCATTERING = np.array([6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2], F)  # at sea level [1 / km]
_OZONE_ABSORPTION = np.array([3.472e-25, 3.914e-25, 1.349e-25, 11.03e-27], F)  # cross section [m^2]
_OZONE_AMOUNT = F(334.5)  # [Dobson units]
_AEROSOL_ABSORPTION = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23], F)  # cross section [m^2]
_AEROSOL_SCATTERING = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22], F)  # cross section [m^2]
_AEROSOL_DENSITY = F(1.3681e20)  # number density at sea level
_AEROSOL_BACKGROUND = F(2e6)  # number density everywhere
_AEROSOL_HEIGHT = F(0.73)  # height at which the density is 1 / e of that at sea level [km]
_REPEATED = np.array([0.217, 0.347, 0.594, 1.0], F)  # light that air has scattered more than once
# XYZ of light of each of the four wavelengths
_TO_XYZ = np.array(
    [
        (53.386917738564668023, 22.981337506691024754, 0.0),
        (43.904844466369358263, 71.347795700053393866, 0.102506867965741307),
        (1.6137278251608962005, 18.422960591455485011, 31.742921188390805758),
        (20.762668673810577145, 2.3614213523314368527, 110.48009643252140334),
    ],
    F,
)


@functools.lru_cache(maxsize=4)
def multiple_scattering_picture(atmosphere: Atmosphere) -> np.ndarray:
    """Radiance of the sky, and of the air in front of the ground; see `atmosphere.py` for its layout. Read only."""
    light = _Light(_lit_table(atmosphere.air, atmosphere.aerosol, atmosphere.ozone), atmosphere)
    cosine = np.cos(F(0.5 * math.pi) - F(atmosphere.sun_elevation))
    sun = _sun_direction(cosine)
    height = F(np.clip(atmosphere.altitude, *ALTITUDE_RANGE)) / F(1000)

    def render(rows: np.ndarray) -> np.ndarray:
        v = (rows.astype(F) + F(0.5)) / F(PICTURE_HEIGHT) * F(2) - F(1)
        elevation = (np.copysign(v * v, v) * F(0.5 * math.pi))[:, None]
        azimuth = (F(2 * math.pi) * ((np.arange(PICTURE_WIDTH // 2).astype(F) + F(0.5)) / F(PICTURE_WIDTH)))[None, :]
        flat = _rounded(np.cos, elevation)
        x, y, z = np.broadcast_arrays(
            flat * _rounded(np.cos, azimuth), flat * _rounded(np.sin, azimuth), _rounded(np.sin, elevation)
        )
        return _to_xyz(light.scattered((x.ravel(), y.ravel(), z.ravel()), sun, _EARTH + height)).reshape(*x.shape, 3)

    picture = in_parts(0, render)
    picture.flags.writeable = False
    return picture


def multiple_scattering_disc(atmosphere: Atmosphere, size: float) -> SunDisc:
    """The sun's disc of angular diameter `size` [rad]."""
    solid_angle = F(2 * math.pi) * (F(1) - np.cos(F(size) / F(2)))
    height = F(np.clip(atmosphere.altitude, *ALTITUDE_RANGE)) / F(1000)

    def color(elevation: np.float32) -> tuple[float, float, float]:
        cosine = np.array([np.cos(F(0.5 * math.pi) - elevation)], F)
        passed = _transmittance(cosine, np.array([height / _THICKNESS], F), atmosphere)
        x, y, z = _to_xyz(_IRRADIANCE * passed / solid_angle)[0]
        return float(x), float(y), float(z)

    half = F(size) / F(2)
    return SunDisc(color(F(atmosphere.sun_elevation) - half), color(F(atmosphere.sun_elevation) + half))


MULTIPLE_SCATTERING = SkyModel(multiple_scattering_picture, multiple_scattering_disc)


def _sun_direction(cosine):
    return -np.sqrt(F(1) - cosine * cosine), np.zeros_like(cosine), cosine


def _to_xyz(spectrum: np.ndarray) -> np.ndarray:
    result = np.zeros((*spectrum.shape[:-1], 3), F)
    for i, color in enumerate(_TO_XYZ):
        result += color * spectrum[..., i, None]
    return result


def _lerp(a, b, t):
    return a + t * (b - a)


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
    share = _rounded(np.exp, -altitude / _AEROSOL_HEIGHT) + _AEROSOL_BACKGROUND / _AEROSOL_DENSITY
    density = (_AEROSOL_DENSITY * share * F(atmosphere.aerosol))[..., None]
    height = _rounded(np.log, np.maximum(altitude, F(1e-4)))
    from_peak = height - F(3.22261)
    ozone = F(3.78547397e20) * _rounded(np.exp, -(from_peak * from_peak) * F(5.55555555) - height)
    ozone_absorption = _OZONE_ABSORPTION * _OZONE_AMOUNT * ozone[..., None] * F(atmosphere.ozone)
    thin = _rounded(np.exp, F(-0.07771971) * _rounded(np.power, altitude, F(1.16364243)))
    air = _AIR_SCATTERING * thin[..., None] * F(atmosphere.air)
    aerosol = _AEROSOL_SCATTERING * density
    return _Coefficients(air, aerosol, _AEROSOL_ABSORPTION * density + aerosol + ozone_absorption + air)


def _transmittance(cosine: np.ndarray, height: np.ndarray, atmosphere: Atmosphere) -> np.ndarray:
    """Share of sunlight at `height` (0: ground, 1: top) when the sun's zenith angle has `cosine`: [..., 4]."""
    x, _, z = _sun_direction(cosine)
    start = _lerp(_EARTH, _TOP, height)
    step = _to_sphere(start, (x, None, z), _TOP) / F(_SEGMENTS)
    depth = np.zeros((*cosine.shape, 4), F)
    for i in range(_SEGMENTS):
        t = (F(i) + F(0.5)) * step
        altitude = np.maximum(_length(x * t, F(0), start + z * t) - _EARTH, F(0))
        depth += _coefficients(altitude, atmosphere).extinction * step[..., None]
    return _rounded(np.exp, -depth)


@functools.lru_cache(maxsize=4)
def _lit_table(air: float, aerosol: float, ozone: float) -> np.ndarray:
    """`_transmittance` by height and cosine: [_LIGHT_HEIGHT, _LIGHT_WIDTH, 4]."""
    u = np.arange(_LIGHT_WIDTH).astype(F) / F(_LIGHT_WIDTH - 1)
    v = np.arange(_LIGHT_HEIGHT).astype(F) / F(_LIGHT_HEIGHT - 1)
    cosine, height = np.broadcast_arrays((u * F(2) - F(1))[None, :], v[:, None])
    return _transmittance(cosine, height, Atmosphere(0.0, 0.0, air, aerosol, ozone))


class _Light:
    """Light within the atmosphere."""

    def __init__(self, table: np.ndarray, atmosphere: Atmosphere) -> None:
        self._table = table.reshape(-1, 4)
        self._atmosphere = atmosphere

    def scattered(self, direction: tuple[np.ndarray, ...], sun, start: np.float32) -> np.ndarray:
        """Light from `direction` (arrays of shape [n]) to a viewer `start` [km] above the Earth's centre: [n, 4]."""
        x, y, z = direction
        ground = _to_sphere(start, direction, _EARTH)
        step = np.where(ground < 0, _to_sphere(start, direction, _TOP), ground) / F(_SEGMENTS)
        cosine = -x * sun[0] + -y * sun[1] + -z * sun[2]
        air_phase = (F(3.0 / 16.0 / math.pi) * (F(1) + cosine * cosine))[:, None]
        spread = F(1) + _FORWARD * _FORWARD + F(2) * _FORWARD * cosine
        aerosol_phase = (F(0.25 / math.pi) * (F(1) - _FORWARD * _FORWARD) / (spread * np.sqrt(spread)))[:, None]
        result = np.zeros((len(x), 4), F)
        passed = np.ones((len(x), 4), F)
        for i in range(_SEGMENTS):
            t = (F(i) + F(0.5)) * step
            px, py, pz = x * t, y * t, start + z * t
            from_centre = _length(px, py, pz)
            altitude = np.maximum(from_centre - _EARTH, F(0))
            height = altitude / _THICKNESS
            sun_cosine = px / from_centre * sun[0] + py / from_centre * sun[1] + pz / from_centre * sun[2]
            here = _coefficients(altitude, self._atmosphere)
            lit, repeated = self._lit(sun_cosine, height), self._repeated(sun_cosine, height, from_centre)
            source = _IRRADIANCE * (
                here.air * (air_phase * lit + repeated) + here.aerosol * (aerosol_phase * lit + repeated)
            )
            kept = _rounded(np.exp, -step[:, None] * here.extinction)
            result += passed * ((source - source * kept) / np.maximum(here.extinction, F(1e-7)))
            passed *= kept
        return result

    def _columns(self, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = F(_LIGHT_WIDTH - 1) * np.clip(cosine * F(0.5) + F(0.5), F(0), F(1))
        low = x.astype(np.int32)
        return low, np.minimum(low + 1, _LIGHT_WIDTH - 1), (x - low.astype(F))[:, None]

    def _rows(self, height: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        y = F(_LIGHT_HEIGHT - 1) * np.clip(height, F(0), F(1))
        low = y.astype(np.int32)
        return low * _LIGHT_WIDTH, np.minimum(low + 1, _LIGHT_HEIGHT - 1) * _LIGHT_WIDTH, (y - low.astype(F))[:, None]

    def _lit(self, cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Transmittance to the sun at a zenith angle of this cosine and at `height`."""
        left, right, fx = self._columns(cosine)
        lower, upper, fy = self._rows(height)
        table = self._table
        return _lerp(
            _lerp(table[lower + left], table[lower + right], fx),
            _lerp(table[upper + left], table[upper + right], fx),
            fy,
        )

    def _repeated(self, cosine: np.ndarray, height: np.ndarray, from_centre: np.ndarray) -> np.ndarray:
        """Light that was scattered more than once, by air (a fit) and by the ground, for a unit of sunlight."""
        ratio = _EARTH / from_centre
        angle = F(2 * math.pi) * (F(1) - np.sqrt(np.maximum(F(1) - ratio * ratio, F(0))))  # solid angle of the Earth
        left, right, fx = self._columns(cosine)
        to_ground = _lerp(self._table[left], self._table[right], fx)
        lower, upper, fy = self._rows(height)
        last = _LIGHT_WIDTH - 1
        from_ground = self._table[last] / _lerp(self._table[lower + last], self._table[upper + last], fy)
        isotropic = F(0.25 / math.pi)
        ground = (isotropic * angle)[:, None] * (_GROUND * F(1 / math.pi)) * to_ground * from_ground * cosine[:, None]
        air = F(0.02) * _REPEATED * (F(1) / (F(1) + F(5) * np.exp(F(-17.92) * cosine)))[:, None]
        return air + ground
