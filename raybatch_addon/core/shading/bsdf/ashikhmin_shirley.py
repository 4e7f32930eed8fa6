"""Ashikhmin and Shirley's anisotropic Phong lobe ("An Anisotropic Phong BRDF Model", 2000), with the Fresnel factor 1.

The exponents are 2 / alpha^2 - 2 along the tangent and across it, which makes the lobe as wide as a GGX of that alpha.
`half` is in the local frame of tangent, bitangent and normal.
"""

import warp as wp


@wp.func
def phong_exponent(alpha: float) -> float:
    """Exponent of a lobe that is as wide as facets of `alpha` in (0, 1]."""
    return 2.0 / (alpha * alpha) - 2.0


@wp.func
def phong_density(exponent_x: float, exponent_y: float, half: wp.vec3) -> float:
    """Density of half vectors [1/sr] at unit `half`, half[2] > 0."""
    across2 = half[0] * half[0] + half[1] * half[1]
    # the logarithm of the cosine over the squared sine, which is -1/2 at the pole
    rate = -0.5 - 0.25 * across2
    if across2 > 1.0e-3:
        rate = wp.log(wp.max(half[2], 1.0e-6)) / across2
    steep = exponent_x * half[0] * half[0] + exponent_y * half[1] * half[1]
    return wp.sqrt((exponent_x + 1.0) * (exponent_y + 1.0)) / wp.TAU * wp.exp(steep * rate)


@wp.func
def sample_phong(exponent_x: float, exponent_y: float, u: wp.vec2) -> wp.vec3:
    """A unit half vector of density `phong_density`."""
    # one quadrant, and its mirror images
    quarter = 4.0 * u[0]
    quadrant = wp.min(int(quarter), 3)
    turn = 0.5 * wp.PI * (quarter - float(quadrant))
    x = wp.sqrt(exponent_y + 1.0) * wp.cos(turn)
    y = wp.sqrt(exponent_x + 1.0) * wp.sin(turn)
    length = wp.sqrt(x * x + y * y)
    x = x / length
    y = y / length
    exponent = exponent_x * x * x + exponent_y * y * y
    # 1 - cos^2, near 0 from the series in log(u) / (exponent + 1), which does not cancel
    log_cos = wp.log(wp.max(1.0 - u[1], 1.0e-12)) / (exponent + 1.0)
    twice = 2.0 * log_cos
    sine2 = 1.0 - wp.exp(twice)
    if twice > -1.0e-2:
        sine2 = -twice * (1.0 + twice * (0.5 + twice * (1.0 / 6.0 + twice / 24.0)))
    sine = wp.sqrt(wp.max(sine2, 0.0))
    if quadrant == 1 or quadrant == 2:
        x = -x
    if quadrant >= 2:
        y = -y
    return wp.vec3(sine * x, sine * y, wp.exp(log_cos))
