"""GGX microfacets, and mirrored and refracted directions.

GGX with the height-correlated Smith term (Heitz, "Understanding the Masking-Shadowing
Function in Microfacet-Based BRDFs", 2014), alpha = roughness^2. Directions point away from the
surface; `cos_o`, `cos_i` are the cosines to the macroscopic normal, `h` is the microfacet's normal on
the side of wo. `eta` is the index of refraction of the far side relative to that of wo's side.

Everything is written without a division by a cosine, so that grazing directions need no special case.
"""

import warp as wp

# The half vector is known to about 8 * 2**-23 (a few roundings of normalised directions and of their sum). D's
# relative error is at most 2 * that / alpha (the steepest part of 1 / (sin^2 + alpha^2)^2). Below this alpha the error
# would exceed 1/64, and a lobe is taken as perfectly specular instead: its true width, about 2 alpha, is then under a
# quarter of a milliradian. Roughness 0.011.
ALPHA_MIN = 2.0 * 8.0 * 2.0**-23 * 64.0

_alpha_min = wp.constant(ALPHA_MIN)


@wp.func
def is_specular(alpha: float) -> bool:
    """Whether reflection off a surface of `alpha` is taken as a delta lobe."""
    return alpha < _alpha_min


@wp.func
def is_refraction_specular(alpha: float, eta: float) -> bool:
    """Whether refraction is taken as a delta lobe.

    The half vector of refraction, along wo + eta wi, is shorter by |eta - 1|: its error grows, and the
    lobe narrows, by that factor.
    """
    return alpha * wp.min(wp.abs(eta - 1.0), 1.0) < _alpha_min


@wp.func
def ggx_distribution(alpha: float, sin2_h: float) -> float:
    """D(h) [1/sr] from the squared sine of h to the normal (precise near it, where the cosine is not)."""
    t = sin2_h + alpha * alpha * (1.0 - sin2_h)
    d = alpha / t
    return d * d / wp.PI


@wp.func
def ggx_stretched_distribution(alpha_x: float, alpha_y: float, half: wp.vec3) -> float:
    """The anisotropic D(h) [1/sr] for `half` in the local frame, of any length."""
    x = half[0] / alpha_x
    y = half[1] / alpha_y
    t = wp.dot(half, half) / (x * x + y * y + half[2] * half[2])
    return t * t / (wp.PI * alpha_x * alpha_y)


@wp.func
def ggx_slope(alpha: float, cosine: float) -> float:
    """sqrt(cos^2 + alpha^2 sin^2), of which Smith's Lambda is (this / cos - 1) / 2."""
    c2 = cosine * cosine
    return wp.sqrt(c2 + alpha * alpha * wp.max(1.0 - c2, 0.0))


@wp.func
def ggx_visible(alpha: float, cos_o: float) -> float:
    """G1(wo) / cos_o; times D(h) (wo . h) it is the density of visible normals [1/sr]."""
    return 2.0 / (cos_o + ggx_slope(alpha, cos_o))


@wp.func
def ggx_shadowing(alpha: float, cos_o: float, cos_i: float) -> float:
    """G2(wo, wi) / G1(wo) in [0, 1]: the share that remains of a visible-normal sample. Cosines > 0."""
    slope_o = ggx_slope(alpha, cos_o)
    slope_i = ggx_slope(alpha, cos_i)
    return cos_i * (cos_o + slope_o) / (cos_i * slope_o + cos_o * slope_i)


@wp.func
def sample_visible_normal(wo: wp.vec3, alpha_x: float, alpha_y: float, u: wp.vec2) -> wp.vec3:
    """A GGX microfacet normal seen from `wo` (local frame, wo.z > 0), density D(h) (wo . h) G1(wo) / cos_o.

    Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023.
    """
    stretched = wp.normalize(wp.vec3(alpha_x * wo[0], alpha_y * wo[1], wo[2]))
    phi = wp.TAU * u[0]
    height = (1.0 - u[1]) * (1.0 + stretched[2])  # > 0; computed this way it does not cancel
    z = height - stretched[2]
    r = wp.sqrt(wp.max((1.0 - z) * (1.0 + z), 0.0))
    x = r * wp.cos(phi) + stretched[0]
    y = r * wp.sin(phi) + stretched[1]
    return wp.normalize(wp.vec3(alpha_x * x, alpha_y * y, height))


@wp.func
def reflected(wo: wp.vec3, h: wp.vec3) -> wp.vec3:
    """`wo` mirrored about unit `h`."""
    return 2.0 * wp.dot(wo, h) * h - wo


@wp.func
def refracted(wo: wp.vec3, h: wp.vec3, eta: float) -> wp.vec3:
    """Direction behind a facet `h` (wo . h > 0), by Snell's law; zero at total internal reflection."""
    c = wp.dot(wo, h)
    m = (eta - 1.0) * (eta + 1.0)
    g2 = m + c * c  # (eta cos_t)^2, as in fresnel_dielectric: both see the same critical angle
    if g2 <= 0.0:
        return wp.vec3(0.0)
    g = wp.sqrt(g2)
    # (c - g) h - wo, with c - g = -m / (g + c): wi = -wo exactly at eta = 1
    return wp.normalize((-m / (g + c)) * h - wo)
