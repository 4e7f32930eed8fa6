"""Parameters, picture layout and sun's disc that both models of a scattering atmosphere share.

`single_scattering.py` and `multiple_scattering.py` integrate an atmosphere into a picture of the sky, and two colours
of the sun's disc. The models and their constants are those of Blender, so that pictures are the same.

Pictures hold CIE XYZ, float32, shape [PICTURE_HEIGHT, PICTURE_WIDTH, 3], the lowest row first. Columns go once around
the horizon; the sun stands in the middle one (longitude 0 of -pi..pi). Rows are dense near the horizon: at v in [0, 1]
the elevation is sign(2 v - 1) (2 v - 1)^2 pi / 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

PICTURE_WIDTH = 512
PICTURE_HEIGHT = 256
EARTH_RADIUS = 6371.0  # [km]
SUN_SIZE_MIN = 0.0005  # [rad]; the direction to a smaller sun is below the precision of float32
_ROWS_AT_ONCE = 16  # rows whose arrays fit a processor's cache

F = np.float32


@dataclass(frozen=True)
class Atmosphere:
    """Parameters of a scattering sky."""

    sun_elevation: float  # [rad], in -pi / 2..pi / 2
    altitude: float = 100.0  # height of the viewer above the sea [m]
    air: float = 1.0  # density of air over Earth's
    aerosol: float = 1.0  # density of aerosols over an urban air's
    ozone: float = 1.0  # density of ozone over Earth's


@dataclass(frozen=True)
class SunDisc:
    """The sun as a disc: radiance falls towards its rim, and differs between its lowest and its highest point."""

    lowest: tuple[float, float, float]  # XYZ of its lowest point, in the middle column
    highest: tuple[float, float, float]  # XYZ of its highest point


@dataclass(frozen=True)
class SkyModel:
    """How light scatters in an atmosphere."""

    sky_picture: Callable[[Atmosphere], np.ndarray]  # radiance; its layout is above. Read only
    sun_disc: Callable[[Atmosphere, float], SunDisc]  # of an angular diameter [rad]


def wrapped_sun(elevation: float, rotation: float) -> tuple[float, float]:
    """Elevation in -pi / 2..pi / 2 and azimuth in 0..2 pi of the sun at any elevation and rotation [rad].

    Beyond the zenith the sun comes down on the other side. The azimuth counts the other way around than Blender's
    rotation. Angles are rounded to float32, as in Blender: the angle from a small sun's middle shows it.
    """
    half, full, turn = F(0.5 * math.pi), F(math.pi), F(2.0 * math.pi)
    up, around = np.fmod(F(elevation), turn), F(rotation)
    if abs(up) >= full:
        up -= np.copysign(turn, up)
    if abs(up) >= half:
        up = np.copysign(full, up) - up
        around += full
    around = np.fmod(around, turn)
    if around < 0:
        around += turn
    return float(up), float(turn - around)


def sun_direction(elevation: float, azimuth: float) -> tuple[float, float, float]:
    """Unit vector towards a sun of `wrapped_sun`."""
    flat = math.cos(elevation)
    return -flat * math.sin(azimuth), flat * math.cos(azimuth), math.sin(elevation)


def horizon_elevation(altitude: float) -> float:
    """Elevation of the horizon seen from `altitude` [m], at most 0 [rad]."""
    return math.asin(EARTH_RADIUS / (EARTH_RADIUS + altitude / 1000.0)) - 0.5 * math.pi


def in_parts(first: int, render: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """A picture whose left half is `render(rows)` for the rows from `first` on, and black below.

    `render` returns shape [len(rows), PICTURE_WIDTH // 2, 3]. Numbers that are not finite become black too.
    """
    picture = np.zeros((PICTURE_HEIGHT, PICTURE_WIDTH, 3), np.float32)

    def part(begin: int) -> None:
        rows = np.arange(begin, min(begin + _ROWS_AT_ONCE, PICTURE_HEIGHT))
        with np.errstate(all="ignore"):  # air may be so thick that no light gets through
            half = render(rows)
        half[~np.isfinite(half)] = 0.0
        picture[rows, : PICTURE_WIDTH // 2] = half
        picture[rows, PICTURE_WIDTH // 2 :] = half[:, ::-1]

    with ThreadPoolExecutor() as pool:
        list(pool.map(part, range(first, PICTURE_HEIGHT, _ROWS_AT_ONCE)))
    return picture


def sky_table(
    sun: SunDisc | None, elevation: float, azimuth: float, size: float, intensity: float, altitude: float
) -> list[float]:
    """Numbers that the op `sky_scattering` takes besides the picture; without `sun` there is no disc."""
    disc = sun or SunDisc((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return [
        *disc.lowest,
        *disc.highest,
        elevation,
        azimuth,
        size if sun else -1.0,
        intensity,
        horizon_elevation(altitude),
    ]
