"""Hair BSDF: a lobe that reflects and one that passes light, each a cone around the fibre.

Both spread along the fibre by a Cauchy distribution of the half angle between wo and wi; around it the one that
reflects has a cosine's half wave about wo, the one that passes a Cauchy distribution about the other side. To which
side of the surface they go does not matter, as in Cycles. Values contain the cosine, and are densities.

Fields of the record: `roughness` and `aspect`, widths along the fibre and around it [rad]; `film_ior` shift of the half
angle [rad].
"""

from __future__ import annotations

import warp as wp

from ...float32 import HALF_PI
from ..bsdf.materials import ClosureRecord, ShadingFrame
from .chiang import HairDirection
from .fibre import azimuth_of, fibre_direction, fibre_frame

# Nearer to the fibre's direction than this nothing is scattered [rad]
_END = 0.001


@wp.func
def _half_at(theta_o: float, end: float) -> float:
    """The half angle where wi runs along the fibre towards one of its ends (1 or -1), from a lobe that is not
    shifted.
    """
    return 0.5 * (end * HALF_PI + theta_o)


@wp.func
def _around(azimuth: float, width: float, passes: bool) -> float:
    """Density around the fibre."""
    if passes:
        off = wp.PI - wp.abs(azimuth)
        if off > HALF_PI:
            return 0.0
        return width / (2.0 * wp.atan(HALF_PI / width) * (off * off + width * width))
    if wp.abs(azimuth) > HALF_PI:
        return 0.0
    return 0.25 * wp.cos(0.5 * wp.min(wp.abs(azimuth) / width, wp.PI)) / width


@wp.func
def hair_lobe_value(
    closures: wp.array(dtype=ClosureRecord), c: int, frame: ShadingFrame, wo: wp.vec3, wi: wp.vec3, passes: bool
) -> float:
    """f |cos| and density towards wi, which are the same."""
    f = fibre_frame(closures[c].tangent, frame, wo)
    theta_o = wp.asin(f.sin_o)
    theta_i = wp.asin(wp.clamp(wp.dot(wi, f.along), -1.0, 1.0))
    if HALF_PI - wp.abs(theta_i) < wp.static(_END):
        return 0.0
    shift = closures[c].film_ior
    half = 0.5 * (theta_i + theta_o) - shift
    a = wp.atan((_half_at(theta_o, 1.0) - shift) / closures[c].roughness)
    b = wp.atan((_half_at(theta_o, -1.0) - shift) / closures[c].roughness)
    width = closures[c].roughness
    along = width / (2.0 * (half * half + width * width) * (a - b) * wp.cos(theta_i))
    return along * _around(azimuth_of(f, wi), closures[c].aspect, passes)


@wp.func
def sample_hair_lobe(
    closures: wp.array(dtype=ClosureRecord), c: int, frame: ShadingFrame, wo: wp.vec3, u: wp.vec2, passes: bool
) -> HairDirection:
    """A direction with the density of `hair_lobe_value`."""
    f = fibre_frame(closures[c].tangent, frame, wo)
    theta_o = wp.asin(f.sin_o)
    shift = closures[c].film_ior
    width = closures[c].roughness
    a = wp.atan((_half_at(theta_o, 1.0) - shift) / width)
    b = wp.atan((_half_at(theta_o, -1.0) - shift) / width)
    theta_i = 2.0 * (width * wp.tan(u[0] * (a - b) + b) + shift) - theta_o
    spread = closures[c].aspect
    found = HairDirection()
    azimuth = 2.0 * wp.asin(wp.clamp(1.0 - 2.0 * u[1], -1.0, 1.0)) * spread
    if passes:
        azimuth = wp.PI + spread * wp.tan(2.0 * wp.atan(HALF_PI / spread) * (u[1] - 0.5))
        found.passes = 1
    found.direction = fibre_direction(f, wp.sin(theta_i), azimuth)
    return found
