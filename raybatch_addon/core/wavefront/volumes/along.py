"""Points of a ray in a medium from which light is looked for.

Points are sought by their distance to a light (equiangular sampling), and by the transmittance where the medium is the
same everywhere, with the density of both together: the balance heuristic (Kulla and Fajardo, "Importance Sampling
Techniques for Path Tracing in Participating Media", 2012).
"""

from __future__ import annotations

import warp as wp

from .medium import bound_ahead
from .table import EXTINCTION, VolumeData

# Depths below which 1 - exp(-x) is x (1 - x / 2), to rounding
_THIN = 1e-3
# Points are sought by the light within this many mean free paths: it brings little from farther off. Bounds are often
# far denser than the medium
_PATHS_MOST, _BOUND_PATHS_MOST = 4.0, 16.0
# Cells of bounds that are looked at on the way there
_CELLS_MOST = 128
# Angle of the ray, as seen from the light, below which its points are all as near to it [rad]
_ANGLE_LEAST = 1e-3
# How near to a ray a light is taken to be at least, in shares of its distance
_ASIDE_LEAST = 1e-5


@wp.struct
class Sought:
    """The part of a ray where points are sought from which light is looked for."""

    first: float  # it begins there [m]
    last: float  # and ends there [m]; not behind `first`: nothing is sought
    middle: float  # from there a light is chosen to find points by [m]
    nearest: float  # where the ray comes nearest to that light [m]
    aside: float  # how near that is [m]
    seeks: int  # 1: points are sought at all
    angle: float  # of the part, as seen from the light [rad]; 0: no light has a place, or it is far off


@wp.func
def sought_in_constant(extinction: float, reach: float) -> Sought:
    """The part of `reach` [m] in a medium of the mean `extinction` [1/m]."""
    s = Sought()
    s.last = reach
    if extinction * reach > wp.static(_PATHS_MOST):
        s.last = wp.static(_PATHS_MOST) / extinction
    # halfway, or one free path ahead
    s.middle = wp.min(0.5 * reach, 1.0 / wp.max(extinction, 1.0e-30))
    return s


@wp.func
def sought_in_bounds(
    volumes: VolumeData, inside: wp.vec4i, origin: wp.vec3, direction: wp.vec3, time: float, length: float
) -> Sought:
    """The part of `length` [m] in which bounds of the extinction are not 0, and which are not too deep in it."""
    s = Sought()
    t = float(0.0)
    depth = float(0.0)
    cells = int(0)
    while t < length and depth < wp.static(_BOUND_PATHS_MOST) and cells < wp.static(_CELLS_MOST):
        cells += 1
        reach = bound_ahead(volumes, inside, origin + t * direction, direction, time, EXTINCTION)
        end = wp.min(t + reach.length, length)
        if not end > t:
            break
        if reach.bound > 0.0:
            if depth == 0.0:
                s.first = t
            end = wp.min(end, t + (wp.static(_BOUND_PATHS_MOST) - depth) / reach.bound)
            if depth < 1.0:
                s.middle = wp.min(end, t + (1.0 - depth) / reach.bound)
            # depths stay above 0 however thin it is
            depth += wp.max((end - t) * reach.bound, 1.0e-30)
            s.last = end
        t = end
    if depth < 1.0:
        s.middle = 0.5 * (s.first + s.last)
    return s


@wp.func
def towards_light(sought: Sought, way: wp.vec3, direction: wp.vec3) -> Sought:
    """`sought` by a light that lies `way` from its middle [m]; `direction`: of the ray, unit."""
    s = sought
    s.nearest = s.middle + wp.dot(way, direction)
    far = wp.length(wp.cross(way, direction))
    s.aside = wp.max(far, wp.static(_ASIDE_LEAST) * (s.middle + wp.length(way)))
    s.angle = float(0.0)
    if s.aside > 0.0 and s.last > s.first:
        near = s.nearest - s.first
        angle = wp.atan2(s.aside * (s.last - s.first), s.aside * s.aside - near * (s.last - s.nearest))
        if angle > wp.static(_ANGLE_LEAST):
            s.angle = angle
    return s


@wp.func
def length_by_light(s: Sought, u: float) -> float:
    """A length of density `density_by_light` [m]; the light has a place."""
    before = wp.atan2(s.aside, s.nearest - s.first) + u * s.angle
    behind = wp.atan2(s.aside, s.last - s.nearest) + (1.0 - u) * s.angle
    t = float(0.0)
    if before < behind:
        t = s.nearest - s.aside / wp.tan(before)
    else:
        t = s.nearest + s.aside / wp.tan(behind)
    return wp.clamp(t, s.first, s.last)


@wp.func
def density_by_light(s: Sought, t: float) -> float:
    """Density that falls as the light at `t` does, and is 0 where nothing is sought [1/m]; the light has a place."""
    if t < s.first or t > s.last:
        return 0.0
    off = t - s.nearest
    return s.aside / (s.angle * (s.aside * s.aside + off * off))


@wp.func
def _thin_length(extinction: float, reach: float, u: float) -> float:
    """A length below `reach` [m] of density `_length_pdf`."""
    depth = extinction * reach
    result = float(0.0)
    if depth < wp.static(_THIN):
        result = u * reach * (1.0 - 0.5 * depth * (1.0 - u))
    else:
        result = -wp.log(1.0 - u * (1.0 - wp.exp(-depth))) / extinction
    return wp.min(result, reach)


@wp.func
def _length_pdf(extinction: float, reach: float, t: float) -> float:
    """Density that falls as the transmittance does, and is 0 beyond `reach` [1/m]."""
    depth = extinction * reach
    if depth < wp.static(_THIN):
        return (1.0 + depth * (0.5 - t / reach)) / reach
    return extinction * wp.exp(-extinction * t) / (1.0 - wp.exp(-depth))


@wp.func
def lit_length(extinction: wp.vec3, shares: wp.vec3, reach: float, s: Sought, u: wp.vec2) -> wp.vec2:
    """Distance along a ray of a point where light is looked for, below `reach` [m], and its density [1/m].

    `shares`: weights of the channels, whose sum is 1.
    """
    by_light = float(0.0)
    if s.angle > 0.0:
        by_light = float(0.5)
    t = float(0.0)
    if u[0] < by_light:
        t = length_by_light(s, u[1])
    else:
        u_channel = (u[0] - by_light) / (1.0 - by_light)
        chosen = extinction[2]
        if u_channel < shares[0]:
            chosen = extinction[0]
        elif u_channel < shares[0] + shares[1]:
            chosen = extinction[1]
        t = _thin_length(chosen, reach, u[1])
    pdf = float(0.0)
    for axis in range(3):
        if shares[axis] > 0.0:
            pdf += shares[axis] * _length_pdf(extinction[axis], reach, t)
    pdf = pdf * (1.0 - by_light)
    if by_light > 0.0:
        pdf += by_light * density_by_light(s, t)
    return wp.vec2(t, pdf)
