"""Rough diffuse surfaces: Oren and Nayar's V-shaped grooves in Fujii's form, with bounces between grooves.

Y. Fujii, "A tiny improvement of Oren-Nayar reflectance model" (2013); the further bounces are those of the OpenPBR
specification's energy-preserving form. `roughness` in [0, 1] is Fujii's sigma; at 0 it is Lambert's law.
"""

import math

import warp as wp

_SLOPE = math.pi / 2 - 2.0 / 3.0  # factor of the roughness in pi / (value of a flat surface)
_MEAN = (2.0 * math.pi - 5.6) / 3.0  # mean of `_groove` over the hemisphere, approximate


@wp.func
def _groove(cosine: float) -> float:
    """Integral over the hemisphere of the value that grooves add, per unit of roughness."""
    sine2 = wp.max(1.0 - cosine * cosine, 0.0)
    sine = wp.sqrt(sine2)
    # sine (1 - sine^3) / cosine without the quotient, which is 0 / 0 at grazing angles
    steep = sine * cosine * (1.0 + sine + sine2) / (1.0 + sine)
    return sine * (wp.acos(wp.min(cosine, 1.0)) - 2.0 / 3.0 - sine * cosine) + (2.0 / 3.0) * steep


@wp.func
def _single_albedo(roughness: float, flat: float, cosine: float) -> float:
    return flat * (wp.PI + roughness * _groove(cosine))


@wp.func
def rough_diffuse_bsdf(roughness: float, color: wp.vec3, wo: wp.vec3, wi: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """BSDF times the cosine of wi, over the weight [1/sr].

    `color` in [0, 1] is the share of light that each bounce between grooves keeps. A cosine of wo below 0 is taken as
    0.
    """
    cos_i = wp.dot(normal, wi)
    if cos_i <= 0.0:
        return wp.vec3(0.0)
    cos_o = wp.max(wp.dot(normal, wo), 0.0)
    flat = 1.0 / (wp.PI + roughness * wp.static(_SLOPE))
    t = wp.dot(wi, wo) - cos_i * cos_o
    if t > 0.0:
        t = t / wp.max(cos_i, cos_o)
    single = flat * (1.0 + roughness * t)
    average = flat * (wp.PI + roughness * wp.static(_MEAN))
    lost = (1.0 - _single_albedo(roughness, flat, cos_o)) * (1.0 - _single_albedo(roughness, flat, cos_i))
    rest = 1.0 - average
    several = wp.vec3(0.0)
    if rest > 0.0:
        kept = wp.cw_div(wp.cw_mul(color, color), wp.vec3(1.0) - rest * color)
        several = (wp.max(lost, 0.0) / wp.PI * average / rest) * kept
    return cos_i * (wp.vec3(wp.max(single, 0.0)) + several)
