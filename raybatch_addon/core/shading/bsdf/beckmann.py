"""Beckmann's microfacets, with the exact Smith term.

Slopes of the facets are normally distributed with variance alpha^2 / 2 (Walter et al., "Microfacet Models for
Refraction through Rough Surfaces", 2007).
"""

import math

import warp as wp

_ROOT_PI = math.sqrt(math.pi)
# Slopes of a unit surface beyond which one facet in 1e8 lies
_SLOPE_MOST = 4.0
# steps of a root search that halves its bracket at least every second step, and mostly converges quadratically
_STEPS = 12


@wp.func
def beckmann_distribution(alpha_x: float, alpha_y: float, half: wp.vec3) -> float:
    """D(h) [1/sr] for `half` in the local frame, of any length."""
    z2 = half[2] * half[2]
    if z2 == 0.0:
        return 0.0
    x = half[0] / alpha_x
    y = half[1] / alpha_y
    cos2 = z2 / wp.dot(half, half)
    return wp.exp(-(x * x + y * y) / z2) / (wp.PI * alpha_x * alpha_y * cos2 * cos2)


@wp.func
def beckmann_projected(cosine: float, spread: float) -> float:
    """Area of the facets seen at `cosine`, over that of the surface: cos (1 + Lambda).

    `spread` is alpha times the sine.
    """
    if spread <= 0.0:
        return cosine
    a = cosine / spread
    if a > 6.0:  # the terms below are 1 and 0
        return cosine
    return 0.5 * cosine * (1.0 + wp.erf(a)) + spread * wp.exp(-a * a) * wp.static(0.5 / _ROOT_PI)


@wp.func
def _visible_slope_below(x: float, tangent: float) -> float:
    """Share of the facets, up to a factor, that fall towards wo by more than -`x`.

    The surface is stretched to alpha 1 and seen at an angle of this `tangent`.
    """
    return wp.erfc(-x) + tangent * wp.static(1.0 / _ROOT_PI) * wp.exp(-x * x)


@wp.func
def sample_visible_slope(wo: wp.vec3, alpha_x: float, alpha_y: float, u: wp.vec2) -> wp.vec3:
    """A microfacet normal seen from `wo` (local frame, wo.z > 0), density D(h) (wo . h) / `beckmann_projected`.

    Slopes are sampled on the surface stretched to alpha 1: the slope towards wo by inverting its distribution; the
    slope across does not depend on wo (Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using the
    Distribution of Visible Normals", 2014).
    """
    stretched = wp.normalize(wp.vec3(alpha_x * wo[0], alpha_y * wo[1], wo[2]))
    sine = wp.sqrt(stretched[0] * stretched[0] + stretched[1] * stretched[1])
    cos_phi = float(1.0)
    sin_phi = float(0.0)
    if sine > 0.0:
        cos_phi = stretched[0] / sine
        sin_phi = stretched[1] / sine
    # facets with a slope above the cotangent face away
    cotangent = float(wp.static(_SLOPE_MOST))
    if stretched[2] < wp.static(_SLOPE_MOST) * sine:
        cotangent = stretched[2] / sine
    tangent = sine / wp.max(stretched[2], 1.0e-12)
    wanted = u[0] * _visible_slope_below(cotangent, tangent)
    low = float(wp.static(-_SLOPE_MOST))
    high = float(cotangent)
    x = wp.clamp(float(0.0), low, high)
    for _i in range(_STEPS):
        over = _visible_slope_below(x, tangent) - wanted
        if over > 0.0:
            high = x
        else:
            low = x
        slope = wp.static(2.0 / _ROOT_PI) * wp.exp(-x * x) * (1.0 - x * tangent)
        step = x - over / wp.max(slope, 1.0e-30)
        if not (step > low and step < high):
            step = 0.5 * (low + high)
        x = step
    y = wp.erfinv(wp.clamp(2.0 * u[1] - 1.0, -0.9999999, 0.9999999))
    slope_x = alpha_x * (cos_phi * x - sin_phi * y)
    slope_y = alpha_y * (sin_phi * x + cos_phi * y)
    return wp.normalize(wp.vec3(-slope_x, -slope_y, 1.0))
