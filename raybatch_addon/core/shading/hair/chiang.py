"""Principled Hair: a rough dielectric cylinder that absorbs.

Chiang, Bitterli, Tappan and Burley 2016, "A Practical and Controllable Hair and Fur Model for Production Path Tracing",
with the near field of d'Eon et al. 2011: light is reflected (R), passes (TT), is reflected inside once (TRT) or more
often. Each share spreads along the fibre by a longitudinal function and around it by a logistic one, so that values and
densities differ by the shares alone. Values contain the cosine.

Fields of the record: `color` absorption in units of the radius, `roughness` variance along the fibre, `aspect` scale of
the logistic distribution around it, `mean_cosine` variance of what is reflected outside, `film_ior` tilt of the scales
[rad], `ior`.
"""

from __future__ import annotations

import warp as wp

from ..bsdf.fresnel import fresnel_dielectric
from ..bsdf.materials import ClosureRecord, ShadingFrame
from .fibre import FibreFrame, azimuth_of, cosine_of, fibre_direction, fibre_frame

_VARIANCE_SMALL = 0.1  # below it the longitudinal function is computed by logarithms


@wp.struct
class Cylinder:
    """A fibre seen from wo: what becomes of light that leaves towards wo."""

    fibre: FibreFrame
    gamma_o: float  # angle of incidence around the fibre, outside and inside [rad]
    gamma_t: float
    r: float  # shares of light, as in the paper's A_p
    tt: wp.vec3
    trt: wp.vec3
    rest: wp.vec3
    chance: wp.vec4  # of R, TT, TRT and the rest, in sum 1


@wp.func
def _mean(v: wp.vec3) -> float:
    return (v[0] + v[1] + v[2]) * wp.static(1.0 / 3.0)


@wp.func
def cylinder_of(closures: wp.array(dtype=ClosureRecord), c: int, frame: ShadingFrame, wo: wp.vec3) -> Cylinder:
    """The cylinder that closure `c` is."""
    cylinder = Cylinder()
    f = fibre_frame(closures[c].tangent, frame, wo)
    cylinder.fibre = f
    eta = closures[c].ior
    cos_t = cosine_of(f.sin_o / eta)
    # the index as light across the fibre has it (Marschner et al. 2003)
    across = wp.sqrt(wp.max(eta * eta - f.sin_o * f.sin_o, 1.0e-6))
    sin_gamma_t = wp.clamp(f.offset * f.cos_o / across, -1.0, 1.0)
    cylinder.gamma_o = wp.asin(f.offset)
    cylinder.gamma_t = wp.asin(sin_gamma_t)
    length = 2.0 * cosine_of(sin_gamma_t) / wp.max(cos_t, 1.0e-3)
    sigma = closures[c].color
    passed = wp.vec3(wp.exp(-sigma[0] * length), wp.exp(-sigma[1] * length), wp.exp(-sigma[2] * length))
    r = fresnel_dielectric(f.cos_o * cosine_of(f.offset), eta)
    cylinder.r = r
    cylinder.tt = ((1.0 - r) * (1.0 - r)) * passed
    inside = r * passed
    cylinder.trt = wp.cw_mul(cylinder.tt, inside)
    for k in range(3):
        if inside[k] < 1.0:
            cylinder.rest[k] = cylinder.trt[k] * inside[k] / (1.0 - inside[k])
    chance = wp.vec4(r, _mean(cylinder.tt), _mean(cylinder.trt), _mean(cylinder.rest))
    cylinder.chance = chance / (chance[0] + chance[1] + chance[2] + chance[3])
    return cylinder


@wp.func
def cylinder_albedo(cylinder: Cylinder) -> wp.vec3:
    """Share of light that is not absorbed."""
    return wp.vec3(cylinder.r) + cylinder.tt + cylinder.trt + cylinder.rest


@wp.func
def _log_bessel(x: float) -> float:
    """Logarithm of the modified Bessel function I0, x >= 0."""
    if x > 12.0:
        return x + 0.5 * (1.0 / (8.0 * x) - wp.static(1.8378770664093453) - wp.log(x))
    quarter = 0.25 * x * x
    total = float(1.0)
    term = float(1.0)
    for i in range(1, 20):
        term = term * quarter / float(i * i)
        total += term
    return wp.log(total)


@wp.func
def longitudinal(sin_i: float, cos_i: float, sin_o: float, cos_o: float, variance: float) -> float:
    """Density of a direction along the fibre (d'Eon et al. 2011, equation 7): its integral with cos_i over the angle
    is 1.
    """
    inverse = 1.0 / variance
    exponent = _log_bessel(cos_i * cos_o * inverse) - sin_i * sin_o * inverse
    if variance <= wp.static(_VARIANCE_SMALL):
        return wp.exp(exponent - inverse + wp.log(inverse))
    return wp.exp(exponent) / (wp.sinh(inverse) * 2.0 * variance)


@wp.func
def _logistic_below(x: float, scale: float) -> float:
    return 1.0 / (1.0 + wp.exp(wp.min(-x / scale, 88.0)))


@wp.func
def azimuthal(angle: float, scale: float) -> float:
    """Density of an angle around the fibre: logistic, of what is between -pi and pi."""
    turned = angle - wp.TAU * wp.floor((angle + wp.PI) / wp.TAU)
    e = wp.exp(-wp.abs(turned) / scale)
    return e / (scale * (1.0 + e) * (1.0 + e)) / (1.0 - 2.0 * _logistic_below(-wp.PI, scale))


@wp.func
def _sampled_azimuthal(u: float, scale: float) -> float:
    least = _logistic_below(-wp.PI, scale)
    x = u * (1.0 - 2.0 * least) + least
    return wp.clamp(-scale * wp.log(wp.max(1.0 / wp.max(x, 1.0e-30) - 1.0, 1.0e-30)), -wp.PI, wp.PI)


@wp.func
def _turn(p: int, cylinder: Cylinder) -> float:
    """By how much light turns around the fibre that is p times inside."""
    return float(p) * (2.0 * cylinder.gamma_t + wp.PI) - 2.0 * cylinder.gamma_o


@wp.func
def _tilted(p: int, f: FibreFrame, tilt: float) -> wp.vec2:
    """Sine and cosine of wo along the fibre as the scales tilt it: for R by -2, for TT by 1, for TRT by 4 of it."""
    turn = float(-2.0) * tilt
    if p == 1:
        turn = tilt
    if p == 2:
        turn = 4.0 * tilt
    s = wp.sin(turn)
    c = wp.cos(turn)
    return wp.vec2(f.sin_o * c + f.cos_o * s, wp.abs(f.cos_o * c - f.sin_o * s))


@wp.func
def _variance(p: int, closures: wp.array(dtype=ClosureRecord), c: int) -> float:
    if p == 0:
        return closures[c].mean_cosine
    if p == 1:
        return 0.25 * closures[c].roughness
    return 4.0 * closures[c].roughness


@wp.func
def principled_hair_value(closures: wp.array(dtype=ClosureRecord), c: int, cylinder: Cylinder, wi: wp.vec3) -> wp.vec4:
    """(f |cos|, density) towards wi."""
    f = cylinder.fibre
    sin_i = wp.clamp(wp.dot(wi, f.along), -1.0, 1.0)
    cos_i = cosine_of(sin_i)
    azimuth = azimuth_of(f, wi)
    value = wp.vec3(0.0)
    density = float(0.0)
    for p in range(3):
        tilted = _tilted(p, f, closures[c].film_ior)
        both = longitudinal(sin_i, cos_i, tilted[0], tilted[1], _variance(p, closures, c))
        both = both * azimuthal(azimuth - _turn(p, cylinder), closures[c].aspect)
        share = wp.vec3(cylinder.r)
        if p == 1:
            share = cylinder.tt
        if p == 2:
            share = cylinder.trt
        value += both * share
        density += both * cylinder.chance[p]
    both = longitudinal(sin_i, cos_i, f.sin_o, f.cos_o, _variance(3, closures, c)) / wp.TAU
    value += both * cylinder.rest
    density += both * cylinder.chance[3]
    return wp.vec4(value[0], value[1], value[2], density)


@wp.struct
class HairDirection:
    """A direction that a fibre was sampled for."""

    direction: wp.vec3
    passes: int  # 1: light went through the fibre


@wp.func
def sample_principled_hair(
    closures: wp.array(dtype=ClosureRecord), c: int, cylinder: Cylinder, u_lobe: float, u: wp.vec2
) -> HairDirection:
    """A direction with the density of `principled_hair_value`."""
    f = cylinder.fibre
    p = int(3)
    left = float(u_lobe)
    for k in range(3):
        if p == 3:
            if left < cylinder.chance[k]:
                p = k
                left = left / cylinder.chance[k]
            else:
                left = left - cylinder.chance[k]
    if p == 3:
        left = left / wp.max(cylinder.chance[3], 1.0e-30)
    left = wp.clamp(left, 1.0e-5, 1.0)
    variance = _variance(p, closures, c)
    tilted = wp.vec2(f.sin_o, f.cos_o)
    azimuth = wp.TAU * u[0]
    if p < 3:
        tilted = _tilted(p, f, closures[c].film_ior)
        azimuth = _turn(p, cylinder) + _sampled_azimuthal(u[0], closures[c].aspect)
    cosine = 1.0 + variance * wp.log(left + (1.0 - left) * wp.exp(-2.0 / variance))
    sin_i = -cosine * tilted[0] + cosine_of(cosine) * wp.cos(wp.TAU * u[1]) * tilted[1]
    found = HairDirection()
    found.direction = fibre_direction(f, wp.clamp(sin_i, -1.0, 1.0), azimuth)
    found.passes = wp.where(p == 0, 0, 1)
    return found
