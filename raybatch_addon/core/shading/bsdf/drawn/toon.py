"""Toon (TOON): all light within a cone counts alike, and none beyond it, with a smooth edge if wanted.

The cone stands on the normal (`distribution` 0), or on the mirrored direction of wo (1). `roughness` is its half angle
as a share of a right angle, `mean_cosine` the width of its edge, likewise. The model and its density are those of
Cycles: over the cone with its edge, at most a half space, the density is uniform, and the BSDF times the cosine is that
density times the brightness at the angle.
"""

import math

import warp as wp

from ...sampling import tangent_of, to_world

_RIGHT_ANGLE = 0.5 * math.pi
_SIZE_LEAST = 1e-5  # a smaller cone counts as one of this size, as in Cycles


@wp.func
def _share(value: float, least: float) -> float:
    return wp.clamp(value, least, 1.0) * wp.static(_RIGHT_ANGLE)


@wp.func
def cone_depth(size: float, smooth: float) -> float:
    """1 - the cosine of the cone's half angle, its edge included; without cancellation for narrow cones."""
    angle = wp.min(_share(size, wp.static(_SIZE_LEAST)) + _share(smooth, 0.0), wp.static(_RIGHT_ANGLE))
    half = wp.sin(0.5 * angle)
    return 2.0 * half * half


@wp.func
def toon_axis(distribution: int, normal: wp.vec3, wo: wp.vec3) -> wp.vec3:
    """The unit vector that the cone is about."""
    axis = normal
    if distribution == 1:
        axis = (2.0 * wp.dot(normal, wo)) * normal - wo
    return axis


@wp.func
def toon_bsdf(distribution: int, size: float, smooth: float, normal: wp.vec3, wo: wp.vec3, wi: wp.vec3) -> wp.vec2:
    """BSDF times the cosine of wi, over the weight, and the density of `sample_toon` [1/sr].

    Without a brightness the density counts as 0, although directions there are sampled: they carry no light.
    """
    cos_i = wp.dot(normal, wi)
    lit = cos_i > 0.0
    if distribution == 1:
        lit = lit and wp.dot(normal, wo) > 0.0
    brightness = float(0.0)
    if lit:
        # by the chord, which tells small angles where a cosine does not
        angle = 2.0 * wp.asin(wp.min(0.5 * wp.length(wi - toon_axis(distribution, normal, wo)), 1.0))
        inner = _share(size, wp.static(_SIZE_LEAST))
        edge = _share(smooth, 0.0)
        if angle < inner:
            brightness = 1.0
        elif angle < inner + edge:
            brightness = 1.0 - (angle - inner) / edge
    density = float(0.0)
    if brightness > 0.0:
        density = 1.0 / (2.0 * wp.PI * cone_depth(size, smooth))
    return wp.vec2(brightness * density, density)


@wp.func
def sample_toon(distribution: int, size: float, smooth: float, normal: wp.vec3, wo: wp.vec3, u: wp.vec2) -> wp.vec3:
    """A unit direction, uniform over the cone with its edge."""
    axis = toon_axis(distribution, normal, wo)
    depth = u[1] * cone_depth(size, smooth)
    radius = wp.sqrt(wp.max(depth * (2.0 - depth), 0.0))
    angle = wp.TAU * u[0]
    along = tangent_of(axis)
    local = wp.vec3(radius * wp.cos(angle), radius * wp.sin(angle), 1.0 - depth)
    return wp.normalize(to_world(local, along, wp.cross(axis, along), axis))
