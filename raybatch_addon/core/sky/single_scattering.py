"""A sky of light that air and aerosols scatter once, with ozone that absorbs.

Nishita et al., "Display of the Earth Taking into Account Atmospheric Scattering" (SIGGRAPH 1993), over 21 wavelengths.
Numbers are float32 and sums in one order throughout: heights are differences of large numbers, whose rounding can be
seen, and pictures are to be those of Blender.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from .atmosphere import PICTURE_HEIGHT, PICTURE_WIDTH, Atmosphere, F, SkyModel, SunDisc, in_parts

_ALTITUDE_RANGE = (1.0, 59999.0)  # [m]
_EARTH = F(6360e3)  # radius [m]
_TOP = F(6420e3)  # radius of the atmosphere [m]
_AIR_HEIGHT = F(8e3)  # height at which the density of air is 1 / e of that at sea level [m]
_AEROSOL_HEIGHT = F(1.2e3)  # height at which the density of aerosols is 1 / e of that at sea level [m]
_AEROSOL_SCATTERING = F(2e-5)  # at sea level [1 / m]
_AEROSOL_EXTINCTION = F(1.11) * _AEROSOL_SCATTERING  # a part is absorbed
_FORWARD = F(0.76)  # asymmetry of scattering by aerosols
_SEGMENTS = 32  # segments of the ray from the viewer
_FADED = F(0.4)  # sine of the angle below the horizon from which on the sky is black
_STEP = 20.0  # between wavelengths [nm]
_WAVELENGTHS = np.arange(380.0, 781.0, _STEP)

# scattering by air, the inverse fourth power of the wavelength [1 / m]
_AIR_SCATTERING = (1.13114877e-6 / (_WAVELENGTHS * 1e-3) ** 4).astype(F)
# Absorption by ozone where it is densest, every 20 nm from 380 nm on [1e-12 / m]
_OZONE = np.array(
    [
        3251.26849861,
        5853.95365047,
        19771.91155085,
        73095.68762914,
        200845.61514287,
        403839.58096161,
        635513.35912363,
        967070.4118097,
        1547974.00424410,
        2090386.47223331,
        2461280.56164565,
        2735512.99461512,
        2151258.63128643,
        1590518.40791988,
        1123561.97979857,
        735275.51487574,
        464501.30357806,
        330960.79921048,
        225126.12292678,
        148791.2926649,
        168286.23364192,
    ]
)
_OZONE_ABSORPTION = (_OZONE * 1e-12).astype(F)
# CIE 1931 colour matching functions of the 2 degree observer, every 20 nm from 380 nm on: x, y, z
_MATCHING = np.array(
    [
        0.001368,
        0.000039,
        0.006450001,
        0.01431,
        0.000396,
        0.06785001,
        0.13438,
        0.004,
        0.6456,
        0.34828,
        0.023,
        1.74706,
        0.2908,
        0.06,
        1.6692,
        0.09564,
        0.13902,
        0.8129501,
        0.0049,
        0.323,
        0.272,
        0.06327,
        0.71,
        0.07824999,
        0.2904,
        0.954,
        0.0203,
        0.5945,
        0.995,
        0.0039,
        0.9163,
        0.87,
        0.001650001,
        1.0622,
        0.631,
        0.0008,
        0.8544499,
        0.381,
        0.00019,
        0.4479,
        0.175,
        0.00002,
        0.1649,
        0.061,
        0,
        0.04677,
        0.017,
        0,
        0.01135916,
        0.004102,
        0,
        0.002899327,
        0.001047,
        0,
        0.0006900786,
        0.0002492,
        0,
        0.0001661505,
        0.00006,
        0,
        0.00004150994,
        0.00001499,
        0,
    ],
    F,
).reshape(-1, 3)


def _sunlight() -> np.ndarray:
    """Irradiance by the sun outside the atmosphere [W / (m^2 nm)]: a black body of 5778 K, thinned by its distance."""
    metres = _WAVELENGTHS * 1e-9
    planck, light, boltzmann = 6.62607015e-34, 299792458.0, 1.380649e-23
    exitance = 2 * math.pi * planck * light**2 / metres**5 / np.expm1(planck * light / (metres * boltzmann * 5778.0))
    return (exitance * 2.16137657e-14).astype(F)


_IRRADIANCE = _sunlight()

# Gauss-Laguerre quadrature of order 8, for integrands that fall off exponentially; nodes over 25, and weights with the
# exponential undone
_LAGUERRE_NODES, _LAGUERRE_WEIGHTS = np.polynomial.laguerre.laggauss(8)
_NODES = (_LAGUERRE_NODES / 25).astype(F)
_WEIGHTS = (_LAGUERRE_WEIGHTS * np.exp(_LAGUERRE_NODES) / 25).astype(F)

Vector = tuple[np.ndarray, np.ndarray, np.ndarray]  # x, y, z, or amounts of air, aerosol, ozone


@functools.lru_cache(maxsize=4)
def single_scattering_picture(atmosphere: Atmosphere) -> np.ndarray:
    """Radiance of the sky, which fades out below the horizon; see `atmosphere.py` for its layout. Read only."""
    sun = _direction(F(atmosphere.sun_elevation), F(0))
    height = F(np.clip(atmosphere.altitude, *_ALTITUDE_RANGE))
    half = PICTURE_HEIGHT // 2

    def render(rows: np.ndarray) -> np.ndarray:
        elevation = F(0.5 * math.pi) * np.square(rows.astype(F) / F(half) - F(1))
        columns = np.arange(PICTURE_WIDTH // 2).astype(F)
        longitude = F(2.0 * math.pi) / F(PICTURE_WIDTH) * columns - F(math.pi)
        direction = _direction(elevation[:, None], longitude[None, :])
        return _to_xyz(_scattered(np.broadcast_arrays(*direction), sun, height, atmosphere))

    picture = in_parts(half, render)
    height_below = np.sin(F(0.5 * math.pi) * np.square(np.arange(half).astype(F) / F(half) - F(1)))
    fade = np.maximum(F(1) - height_below / _FADED, F(0)) ** 3
    picture[:half] = picture[half] * fade[:, None, None]
    picture.flags.writeable = False
    return picture


def single_scattering_disc(atmosphere: Atmosphere, size: float) -> SunDisc:
    """The sun's disc of angular diameter `size` [rad]; black when it is below the horizon."""
    solid_angle = F(2.0 * math.pi) * (F(1) - np.cos(F(size) / F(2)))
    lowest = max(F(atmosphere.sun_elevation) - F(size) / F(2), F(0))
    highest = max(F(atmosphere.sun_elevation) + F(size) / F(2), F(0))
    if highest <= 0:
        return SunDisc((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    height = F(np.clip(atmosphere.altitude, *_ALTITUDE_RANGE))

    def color(elevation: np.float32) -> tuple[float, float, float]:
        direction = _direction(np.array([elevation], F), F(0))
        air, aerosol, _ = _depth_to_sun((F(0), F(0), np.array([_EARTH + height], F)), direction)
        depth = _AIR_SCATTERING * air * F(atmosphere.air) + _AEROSOL_EXTINCTION * aerosol * F(atmosphere.aerosol)
        x, y, z = _to_xyz(_IRRADIANCE * np.exp(-depth) / solid_angle)
        return float(x), float(y), float(z)

    return SunDisc(color(lowest), color(highest))


SINGLE_SCATTERING = SkyModel(single_scattering_picture, single_scattering_disc)


def _direction(elevation, longitude) -> Vector:
    return np.cos(elevation) * np.cos(longitude), np.cos(elevation) * np.sin(longitude), np.sin(elevation)


def _dot(a: Vector, b: Vector) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _along(start: Vector, direction: Vector, distance) -> Vector:
    return tuple(s + d * distance for s, d in zip(start, direction))


def _to_xyz(spectrum: np.ndarray) -> np.ndarray:
    """XYZ of a spectrum [..., 21]."""
    result = np.zeros((*spectrum.shape[:-1], 3), F)
    for i, matching in enumerate(_MATCHING):
        result += matching * spectrum[..., i, None]
    return result * F(_STEP)


def _amounts(height: np.ndarray) -> Vector:
    """Relative densities of air, aerosol and ozone at `height` [m], 1 at most."""
    ozone = np.maximum(0.0, 1.0 - np.abs(height.astype(np.float64) - 25000.0) / 15000.0)
    return np.exp(-height / _AIR_HEIGHT), np.exp(-height / _AEROSOL_HEIGHT), ozone.astype(F)


def _to_top(start: Vector, direction: Vector) -> np.ndarray:
    """Distance from `start` to the end of the atmosphere [m]."""
    b = F(-2) * -_dot(direction, start)
    c = _dot(start, start) - _TOP * _TOP
    along = (-b + np.sqrt(b * b - F(4) * c)) / F(2)
    end = _along(start, direction, along)
    gap = tuple(s - e for s, e in zip(start, end))
    return np.sqrt(_dot(gap, gap))


def _depth_to_sun(start: Vector, direction: Vector) -> Vector:
    """Amounts of air, aerosol and ozone on the way from `start` out of the atmosphere [m]."""
    length = _to_top(start, direction)
    segment = tuple(length * d for d in direction)
    depth = [np.zeros_like(length) for _ in range(3)]
    for node, weight in zip(_NODES, _WEIGHTS):
        point = tuple(s + node * step for s, step in zip(start, segment))
        for total, amount in zip(depth, _amounts(np.sqrt(_dot(point, point)) - _EARTH)):
            total += amount * weight
    return tuple(total * length for total in depth)


def _scattered(direction: Vector, sun: Vector, height: np.float32, atmosphere: Atmosphere) -> np.ndarray:
    """Spectrum of light from `direction` (arrays of one shape) to a viewer at `height` [m]: [..., 21]."""
    scale = F(atmosphere.air), F(atmosphere.aerosol), F(atmosphere.ozone)
    shape = direction[0].shape
    start = tuple(np.broadcast_to(x, shape) for x in (F(0), F(0), _EARTH + height))
    step = _to_top(start, direction) / F(_SEGMENTS)
    segment = tuple(step * d for d in direction)
    cosine = _dot(direction, sun)
    square = F(1) + cosine * cosine
    air_phase = F(0.1875 / math.pi) * square
    forward2 = _FORWARD * _FORWARD
    spread = np.power(F(1) + forward2 - F(2) * _FORWARD * cosine, F(1.5))
    aerosol_phase = F(3) * (F(1) - forward2) * square / (F(8.0 * math.pi) * (F(2) + forward2) * spread)
    depth = [np.zeros(shape, F) for _ in range(3)]
    spectrum = np.zeros((*shape, len(_WAVELENGTHS)), F)
    point = tuple(s + F(0.5) * d for s, d in zip(start, segment))
    for _ in range(_SEGMENTS):
        amounts = tuple(k * x for k, x in zip(scale, _amounts(np.sqrt(_dot(point, point)) - _EARTH)))
        for total, amount in zip(depth, amounts):
            total += step * amount
        lit = ~_meets_earth(point, sun)
        if lit.any():
            behind = _depth_to_sun(tuple(p[lit] for p in point), sun)
            air, aerosol, ozone = (d[lit] + k * b for d, k, b in zip(depth, scale, behind))
            air_part, aerosol_part = (
                air_phase[lit] * amounts[0][lit],
                aerosol_phase[lit] * amounts[1][lit] * _AEROSOL_SCATTERING,
            )
            extinction = (air[:, None] * _AIR_SCATTERING + (aerosol * _AEROSOL_EXTINCTION)[:, None]) + ozone[
                :, None
            ] * _OZONE_ABSORPTION
            scattered = air_part[:, None] * _AIR_SCATTERING + aerosol_part[:, None]
            spectrum[lit] += np.exp(-extinction) * scattered * _IRRADIANCE * step[lit][:, None]
        point = tuple(p + d for p, d in zip(point, segment))
    return spectrum


def _meets_earth(start: Vector, direction: Vector) -> np.ndarray:
    """Whether a ray along `direction`, the same everywhere, meets the Earth."""
    if direction[2] >= 0:
        return np.zeros(start[0].shape, bool)
    b = F(-2) * -_dot(direction, start)
    c = _dot(start, start) - _EARTH * _EARTH
    return b * b - F(4) * c >= 0
