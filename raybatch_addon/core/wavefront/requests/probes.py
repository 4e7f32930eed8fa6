"""Rays that answer a request: where they begin, and what their hits count.

Occlusion: directions are distributed as the cosine about the normal. Rounded edges: a disk about the point is sampled
along three axes, and every hit of the object is weighed by the density of all three (King, Kulla, Conty and Fajardo,
"BSSRDF Importance Sampling", SIGGRAPH 2013), as in Cycles.
"""

from __future__ import annotations

import warp as wp

from ...float32 import PI
from ...shading.sampling import bitangent_of, sample_cosine_hemisphere, tangent_of, to_world
from ...shading.surface import SurfacePoint, spawn_origin

_STEPS_MOST = 16  # of the root's search, which ends after two to ten


@wp.struct
class Probe:
    """A ray."""

    origin: wp.vec3
    direction: wp.vec3  # unit
    length: float  # [m]
    # of a rounded edge: the axis of the disk and two others, how likely each of them is to be the disk's, and how far
    # from the axis the ray is [m]
    axis: wp.vec3
    tangent: wp.vec3
    bitangent: wp.vec3
    shares: wp.vec3
    radius: float


@wp.func
def cubic_density(radius: float, r: float) -> float:
    """Density of points of a disk at the distance `r` from its middle [1/m2]: (radius - r)^3, normalised."""
    if r >= radius:
        return 0.0
    left = 1.0 - r / radius
    return wp.static(10.0 / PI) * left * left * left / (radius * radius)


@wp.func
def cubic_radius(u: float) -> float:
    """The distance from the middle of the unit disk below which `cubic_density` has the share `u`, by Newton."""
    x = float(0.25)
    step = int(0)
    while step < wp.static(_STEPS_MOST):
        step += 1
        square = x * x
        off = square * (10.0 + x * (-20.0 + x * (15.0 - 4.0 * x))) - u
        rest = 1.0 - x
        slope = 20.0 * x * rest * rest * rest
        if wp.abs(off) < 1.0e-6 or slope == 0.0:
            step = wp.static(_STEPS_MOST)
        else:
            x = wp.clamp(x - off / slope, 0.0, 1.0)
    return x


@wp.func
def occlusion_probe(surface: SurfacePoint, normal: wp.vec3, distance: float, u: wp.vec2) -> Probe:
    """A ray into the half-space about `normal`, from `surface`."""
    probe = Probe()
    probe.direction = to_world(sample_cosine_hemisphere(u), tangent_of(normal), bitangent_of(normal), normal)
    probe.origin = spawn_origin(surface.position, surface.error, surface.geometric_normal, probe.direction)
    probe.length = distance
    return probe


@wp.func
def edge_probe(position: wp.vec3, normal: wp.vec3, radius: float, u: wp.vec2) -> Probe:
    """A ray across the sphere of `radius` about `position`, along or across the triangle's `normal`."""
    tangent = tangent_of(normal)
    bitangent = bitangent_of(normal)
    probe = Probe()
    probe.axis = normal
    probe.tangent = tangent
    probe.bitangent = bitangent
    probe.shares = wp.vec3(0.5, 0.25, 0.25)
    around = 2.0 * u[0]
    if u[0] >= 0.75:
        probe.axis = bitangent
        probe.bitangent = normal
        probe.shares = wp.vec3(0.25, 0.25, 0.5)
        around = 4.0 * (u[0] - 0.75)
    elif u[0] >= 0.5:
        probe.axis = tangent
        probe.tangent = normal
        probe.shares = wp.vec3(0.25, 0.5, 0.25)
        around = 4.0 * (u[0] - 0.5)
    phi = wp.TAU * around
    probe.radius = radius * cubic_radius(u[1])
    height = wp.sqrt(wp.max((radius - probe.radius) * (radius + probe.radius), 0.0))
    aside = probe.radius * (wp.cos(phi) * probe.tangent + wp.sin(phi) * probe.bitangent)
    probe.origin = position + height * probe.axis + aside
    probe.direction = -probe.axis
    probe.length = 2.0 * height
    return probe


@wp.func
def edge_weight(probe: Probe, radius: float, distance: float, normal: wp.vec3) -> float:
    """What a hit of an edge probe counts, at `distance` from the middle, on a triangle of unit `normal`."""
    along = probe.shares[0] * wp.abs(wp.dot(probe.axis, normal))
    over_tangent = probe.shares[1] * wp.abs(wp.dot(probe.tangent, normal))
    over_bitangent = probe.shares[2] * wp.abs(wp.dot(probe.bitangent, normal))
    squares = along * along + over_tangent * over_tangent + over_bitangent * over_bitangent
    density = cubic_density(radius, probe.radius)
    if squares <= 0.0 or density <= 0.0:
        return 0.0
    return along / squares * cubic_density(radius, distance) / density
