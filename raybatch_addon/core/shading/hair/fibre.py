"""A fibre as it is seen from wo: axes across it, and angles along it.

The axes are the fibre's own, `along`; `towards`, wo without its part along the fibre; and `beside`, the third one.
Azimuths count from `towards` to `beside`, so that wo has azimuth 0.
"""

from __future__ import annotations

import warp as wp

from ..bsdf.materials import ShadingFrame
from ..sampling import tangent_of


@wp.struct
class FibreFrame:
    """Axes of a fibre at a point of its surface, and wo in them."""

    along: wp.vec3
    towards: wp.vec3
    beside: wp.vec3
    sin_o: float  # wo along the fibre
    cos_o: float  # and across it
    offset: float  # where wo's ray meets the fibre: sine of the angle from the normal to wo, -1..1


@wp.func
def cosine_of(sine: float) -> float:
    """Cosine, not negative, of the angle whose sine is given; beyond 1 it is 0."""
    return wp.sqrt(wp.max(1.0 - sine * sine, 0.0))


@wp.func
def fibre_frame(tangent: wp.vec3, frame: ShadingFrame, wo: wp.vec3) -> FibreFrame:
    """The frame of a fibre with the unit `tangent`; without one, any tangent of the surface."""
    f = FibreFrame()
    f.along = tangent
    if wp.dot(tangent, tangent) < 0.5:
        f.along = frame.tangent
    f.sin_o = wp.clamp(wp.dot(wo, f.along), -1.0, 1.0)
    across = wo - f.sin_o * f.along
    f.cos_o = wp.length(across)
    if f.cos_o > 1.0e-6:
        f.towards = across / f.cos_o
    else:  # along the fibre every azimuth is as good
        f.cos_o = 0.0
        f.towards = tangent_of(f.along)
    f.beside = wp.cross(f.along, f.towards)
    normal = frame.geometric_normal - wp.dot(frame.geometric_normal, f.along) * f.along
    size = wp.length(normal)
    if size > 1.0e-6:
        f.offset = wp.clamp(-wp.dot(normal, f.beside) / size, -1.0, 1.0)
    return f


@wp.func
def fibre_direction(f: FibreFrame, sine: float, azimuth: float) -> wp.vec3:
    """The unit direction with this sine along the fibre, at this azimuth."""
    across = wp.cos(azimuth) * f.towards + wp.sin(azimuth) * f.beside
    return wp.normalize(sine * f.along + cosine_of(sine) * across)


@wp.func
def azimuth_of(f: FibreFrame, wi: wp.vec3) -> float:
    """Azimuth of `wi`, -pi to pi."""
    return wp.atan2(wp.dot(wi, f.beside), wp.dot(wi, f.towards))
