"""The sun of a sky: a cone of directions beside the table of a world, whose texels are too coarse for it.

A direction is chosen within the cone with a fixed probability, by solid angle, and by the table of texels without the
sun's light otherwise; densities are those of both together.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...scene.description import SkySun
from ..sampling import cone_pdf

# The cone is wider than the sun, so that no direction which shows it is outside after rounding
_WIDER = 1.001
_WIDER_BY = 3e-7  # [rad]
# Share of the directions that the table keeps: light that its texels' test points missed is still found
_LEFT = 1e-3
# Texels from the cone's edge up to which some of them show the sun, and in which the sky around it is looked at
_TOUCHED = 1.0
_AROUND = 3.0


@wp.struct
class SunCone:
    """The sun of a sampled world."""

    direction: wp.vec3  # unit, towards its middle
    one_minus_cos: float  # of its angular radius
    share: float  # probability that a direction is chosen within it; 0: there is none


def sun_cone(sun: SkySun, share: float) -> SunCone:
    """The cone of `sun`, to which the `share` 0..1 of the light comes from."""
    cone = SunCone()
    cone.direction = wp.vec3(*_unit(sun))
    cone.one_minus_cos = 2.0 * float(np.sin(_radius(sun) / 2)) ** 2
    cone.share = min(share, 1.0 - _LEFT)
    return cone


def solid_angle(sun: SkySun) -> float:
    """Of its disc [sr]."""
    return 4 * np.pi * float(np.sin(sun.size / 4)) ** 2


def directions_within(sun: SkySun, count: int) -> np.ndarray:
    """Unit vectors evenly spread over the disc, float32, shape [count, 3]: a spiral by the golden angle."""
    index = np.arange(count)
    down = (index + 0.5) / count * 2 * np.sin(sun.size / 4) ** 2  # 1 - cos
    around = index * (np.pi * (3 - np.sqrt(5)))
    beside = np.sqrt(down * (2 - down))
    axis = _unit(sun)
    tangent = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(axis, tangent)
    x, y = beside * np.cos(around), beside * np.sin(around)
    return (x[:, None] * tangent + y[:, None] * bitangent + (1 - down)[:, None] * axis).astype(np.float32)


def without_sun(light: np.ndarray, sun: SkySun) -> np.ndarray:
    """The `light` of texels that `build_world_table` takes, where the sun is at most as bright as the sky around it."""
    height, width = light.shape
    step = np.pi / height
    radius = _radius(sun)
    axis = _unit(sun)
    down = float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
    reach = radius + (_AROUND + 1) * step
    first, last = (int(np.clip((down + side * reach) / step, 0, height - 1)) for side in (-1, 1))
    theta = ((np.arange(first, last + 1) + 0.5) * step)[:, None]
    phi = (np.arange(width) + 0.5) * (2 * np.pi / width)
    cosine = (axis[0] * np.cos(phi) + axis[1] * np.sin(phi)) * np.sin(theta) + axis[2] * np.cos(theta)
    angle = np.arccos(np.clip(cosine, -1, 1))
    result = light.copy()
    rows = result[first : last + 1]
    inside = angle <= radius + _TOUCHED * step
    ring = ~inside & (angle <= radius + _AROUND * step)
    rows[inside] = np.minimum(rows[inside], np.median(rows[ring]) if ring.any() else 0)
    return result


def _radius(sun: SkySun) -> float:
    """Angular radius of its cone [rad]."""
    return sun.size / 2 * _WIDER + _WIDER_BY


def _unit(sun: SkySun) -> np.ndarray:
    direction = np.array(sun.direction, float)
    return direction / np.linalg.norm(direction)


@wp.func
def sun_cone_pdf(sun: SunCone) -> float:
    """Density with which a direction within the cone is chosen there [1/sr]."""
    return sun.share * cone_pdf(sun.one_minus_cos)
