"""Coefficients of the sky of Preetham, Shirley and Smits.

"A Practical Analytic Model for Daylight" (SIGGRAPH 1999), appendix A.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

_BRIGHTNESS = 0.06  # scale of luminances in Blender

# Distribution coefficients A to E are a * turbidity + b, for luminance and the chromaticities x and y
_SHAPES = np.array(
    [
        [(0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)],
        [(-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)],
        [(-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)],
    ],
    np.float32,
)
# Chromaticities of the zenith: rows by power 2, 1, 0 of the turbidity, columns by power 3, 2, 1, 0 of the sun's zenith
# angle
_ZENITH_X = np.array(
    [(0.00166, -0.00375, 0.00209, 0.0), (-0.02903, 0.06377, -0.03202, 0.00394), (0.11693, -0.21196, 0.06052, 0.25886)]
)
_ZENITH_Y = np.array(
    [(0.00275, -0.00610, 0.00317, 0.0), (-0.04214, 0.08970, -0.04153, 0.00516), (0.15346, -0.26756, 0.06670, 0.26688)]
)


def sun_angles(direction: Sequence[float]) -> tuple[float, float]:
    """Angles of the sun [rad]: around the zenith, from the y axis on, and from the zenith.

    Both are 0 for a vector without direction.
    """
    x, y, z = (float(c) for c in direction)
    length = math.sqrt(x * x + y * y + z * z)
    if not (0.0 < length < math.inf):
        return 0.0, 0.0
    return math.atan2(x, y), math.acos(max(-1.0, min(z / length, 1.0)))


def preetham_table(sun: Sequence[float], turbidity: float) -> list[float]:
    """The 32 numbers that the op `sky_preetham` takes, for a sun in the direction `sun`."""
    phi, theta = sun_angles(sun)
    # float32, as in Blender: at the horizon exponents are a thousand times as large
    shapes = _SHAPES[..., 0] * np.float32(turbidity) + _SHAPES[..., 1]
    chi = (4.0 / 9.0 - turbidity / 120.0) * (math.pi - 2.0 * theta)
    luminance = ((4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192) * _BRIGHTNESS
    powers = np.array([turbidity**2, turbidity, 1.0])
    angles = np.array([theta**3, theta**2, theta, 1.0])
    zenith = [luminance, powers @ _ZENITH_X @ angles, powers @ _ZENITH_Y @ angles]
    radiances = [value / _at_zenith(shape, theta) for value, shape in zip(zenith, shapes)]
    padded = np.zeros((3, 9))
    padded[:, :5] = shapes
    return [phi, theta, *(float(r) for r in radiances), *(float(c) for c in padded.ravel())]


def _at_zenith(shape: np.ndarray, theta: float) -> float:
    """Perez' function at the zenith for a sun at angle `theta` from it."""
    a, b, c, d, e = (float(each) for each in shape)
    return (1.0 + a * math.exp(b)) * (1.0 + c * math.exp(d * theta) + e * math.cos(theta) ** 2)
