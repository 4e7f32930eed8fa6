"""Points of a ray in a medium that is the same everywhere, from which light is looked for.

A point is found by the transmittance or by its distance to a light (equiangular sampling), with the density of both
together: the balance heuristic (Kulla and Fajardo, "Importance Sampling Techniques for Path Tracing in Participating
Media", 2012).
"""

from __future__ import annotations

import warp as wp

# Depths below which 1 - exp(-x) is x (1 - x / 2), to rounding
_THIN = 1e-3
# Points are sought by the light within this many mean free paths: it brings little from farther off
_PATHS_MOST = 4.0
# Angle of the ray, as seen from the light, below which its points are all as near to it [rad]
_ANGLE_LEAST = 1e-3


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
def lit_length(extinction: wp.vec3, shares: wp.vec3, reach: float, nearest: float, aside: float, u: wp.vec2) -> wp.vec2:
    """Distance along a ray of a point where light is looked for, below `reach` [m], and its density [1/m].

    `shares`: weights of the channels, whose sum is 1. `nearest`: how far along the ray it comes nearest to a light [m],
    `aside`: how near that is [m]; 0: the light has no place.
    """
    mean = wp.dot(shares, extinction)
    near = float(reach)
    if mean * reach > wp.static(_PATHS_MOST):
        near = wp.static(_PATHS_MOST) / mean
    angle = float(0.0)
    by_light = float(0.0)
    if aside > 0.0:
        # seen from the light, from the ray's begin to `near`
        angle = wp.atan2(aside * near, aside * aside - nearest * (near - nearest))
        if angle > wp.static(_ANGLE_LEAST):
            by_light = float(0.5)
    t = float(0.0)
    if u[0] < by_light:
        before = wp.atan2(aside, nearest) + u[1] * angle
        behind = wp.atan2(aside, near - nearest) + (1.0 - u[1]) * angle
        if before < behind:
            t = nearest - aside / wp.tan(before)
        else:
            t = nearest + aside / wp.tan(behind)
        t = wp.clamp(t, 0.0, near)
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
    if by_light > 0.0 and t <= near:
        off = t - nearest
        pdf += by_light * aside / (angle * (aside * aside + off * off))
    return wp.vec2(t, pdf)
