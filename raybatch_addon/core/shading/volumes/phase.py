"""Phase functions: how light that a volume scatters is distributed by the cosine to the direction that it came along.

Each integrates to 1 over the sphere, and is sampled by a density of its own: the same function, but for Draine's.
"""

from __future__ import annotations

import warp as wp

from ...scene.description import ClosureKind
from ..bsdf.subsurface import phase_cosine, phase_density

HENYEY_GREENSTEIN = int(ClosureKind.HENYEY_GREENSTEIN)
FOURNIER_FORAND = int(ClosureKind.FOURNIER_FORAND)
DRAINE = int(ClosureKind.DRAINE)
RAYLEIGH = int(ClosureKind.RAYLEIGH)
# Mean cosines of larger size count as this, as in Cycles
G_MOST = 1.0 - 1e-3
# Particles of Fournier and Forand: least index of refraction, and most light that goes back
INDEX_LEAST, BACK_MOST = 1.0 + 1e-3, 0.5 - 1e-3
# Halvings of an interval of logarithms, and the least sin²(theta / 2), where a distribution is inverted
_HALVINGS = 40
_LOWEST = -60.0


@wp.struct
class PhaseLobe:
    """One scattering closure of a volume."""

    kind: int  # `ClosureKind`
    weight: wp.vec3  # its scattering coefficient [1/m]
    first: float  # mean cosine; FOURNIER_FORAND: index of refraction of the particles
    second: float  # DRAINE: factor of the squared cosine; FOURNIER_FORAND: share of light that goes back


@wp.func
def usable_cosine(g: float) -> float:
    """A mean cosine within the range that is rendered; 0 for NaN."""
    result = float(0.0)
    if g > 0.0:
        result = wp.min(g, wp.static(G_MOST))
    elif g < 0.0:
        result = wp.max(g, wp.static(-G_MOST))
    return result


@wp.struct
class Particles:
    """Fournier and Forand's parameters, in float64: their terms nearly cancel."""

    scale: wp.float64  # delta over sin²(theta / 2)
    slope: wp.float64  # nu
    tail: wp.float64  # factor of the term of large angles


@wp.func
def _particles(index: float, back: float) -> Particles:
    n = wp.float64(wp.max(index, wp.static(INDEX_LEAST))) - wp.float64(1.0)
    share = wp.float64(wp.clamp(back, 0.0, wp.static(BACK_MOST)))
    p = Particles()
    p.scale = wp.float64(4.0) / (wp.float64(3.0) * n * n)
    one = wp.float64(1.0)
    at_90 = wp.float64(0.5) * p.scale
    if wp.abs(at_90 - one) < wp.float64(1e-6):  # both of the fraction below are 0
        at_90 = one + wp.float64(1e-6)
    at_180 = p.scale
    if wp.abs(at_180 - one) < wp.float64(1e-6):
        at_180 = one + wp.float64(1e-6)
    p.slope = -wp.log(wp.float64(2.0) * share * (at_90 - one) + one) / wp.log(at_90)
    p.tail = (wp.pow(at_180, -p.slope) - one) / (at_180 - one)
    return p


@wp.func
def _power_ratio(exponent: wp.float64, delta: wp.float64) -> wp.float64:
    """(1 - delta^exponent) / (1 - delta), also where delta is near 1."""
    one = wp.float64(1.0)
    result = exponent * (one + wp.float64(0.5) * (exponent - one) * (delta - one))
    if wp.abs(one - delta) > wp.float64(1e-5):
        result = (one - wp.pow(delta, exponent)) / (one - delta)
    return result


@wp.func
def _fournier_forand_share(p: Particles, s: wp.float64) -> wp.float64:
    """Share of light that is scattered by less than theta, where `s` is sin²(theta / 2)."""
    one = wp.float64(1.0)
    delta = p.scale * s
    cosine = one - wp.float64(2.0) * s
    near = (_power_ratio(p.slope + one, delta) - _power_ratio(p.slope, delta) * s) * wp.pow(delta, -p.slope)
    return near + wp.float64(0.125) * p.tail * cosine * (one - cosine * cosine)


@wp.func
def _fournier_forand(p: Particles, cosine: float) -> float:
    """Fournier and Forand's phase function [1/sr] ("Analytic phase function for ocean water", 1994; as corrected by
    Fournier and Jonasz, 1999).
    """
    one = wp.float64(1.0)
    c = wp.float64(cosine)
    s = wp.max(wp.float64(0.5) * (one - c), wp.float64(1e-16))
    delta = p.scale * s
    nu = p.slope
    apart = one - delta
    value = wp.float64(0.0)
    if wp.abs(apart) < wp.float64(1e-4):
        # its series about delta = 1
        value = nu * ((nu - one) - (nu + one) / s) * wp.float64(0.5)
        linear = wp.float64(2.0) * (nu - one) - (wp.float64(2.0) * nu + one) / s
        value = value + nu * (nu + one) * apart * linear / wp.float64(6.0)
    else:
        power = wp.pow(delta, nu)
        rest = one - power
        value = (nu * apart - rest + (delta * rest - nu * apart) / s) / (apart * apart * power)
    value = value + wp.float64(0.25) * p.tail * (wp.float64(3.0) * c * c - one)
    return wp.max(float(value / (wp.float64(4.0) * wp.float64(wp.PI))), 0.0)


@wp.func
def _fournier_forand_cosine(p: Particles, u: float) -> float:
    """A cosine of that density: its distribution is inverted by halving an interval of logarithms of `s`."""
    low = wp.float64(wp.static(_LOWEST))
    high = wp.float64(0.0)
    for _i in range(wp.static(_HALVINGS)):
        middle = wp.float64(0.5) * (low + high)
        if _fournier_forand_share(p, wp.exp(middle)) < wp.float64(u):
            low = middle
        else:
            high = middle
    return wp.clamp(float(wp.float64(1.0) - wp.float64(2.0) * wp.exp(high)), -1.0, 1.0)


@wp.func
def _draine_factor(g: float, alpha: float, cosine: float) -> float:
    """Draine's phase function over Henyey and Greenstein's ("Scattering by interstellar dust grains", 2003)."""
    return (1.0 + alpha * cosine * cosine) / (1.0 + alpha * (1.0 + 2.0 * g * g) * (1.0 / 3.0))


@wp.func
def _rayleigh_cosine(u: float) -> float:
    """A cosine of density 3 (1 + c²) / 8 (Frisvad, "Importance sampling the Rayleigh phase function", 2011)."""
    middle = 2.0 * (2.0 * u - 1.0)
    root = wp.pow(wp.abs(middle) + wp.sqrt(middle * middle + 1.0), 1.0 / 3.0)
    cosine = root - 1.0 / root
    return wp.clamp(wp.where(middle < 0.0, -cosine, cosine), -1.0, 1.0)


@wp.func
def phase_value(lobe: PhaseLobe, cosine: float) -> float:
    """The phase function of `lobe` [1/sr]; `cosine` is 1 for light that goes straight on."""
    value = phase_density(lobe.first, cosine)
    if lobe.kind == wp.static(DRAINE):
        value = value * _draine_factor(lobe.first, lobe.second, cosine)
    elif lobe.kind == wp.static(RAYLEIGH):
        value = (1.0 + cosine * cosine) * 3.0 / (16.0 * wp.PI)
    elif lobe.kind == wp.static(FOURNIER_FORAND):
        value = _fournier_forand(_particles(lobe.first, lobe.second), cosine)
    return value


@wp.func
def phase_pdf(lobe: PhaseLobe, cosine: float) -> float:
    """Density with which `sampled_cosine` finds a direction at `cosine` [1/sr]."""
    if lobe.kind == wp.static(DRAINE):
        return phase_density(lobe.first, cosine)
    return phase_value(lobe, cosine)


@wp.func
def sampled_cosine(lobe: PhaseLobe, u: float) -> float:
    """A cosine of density `phase_pdf`, up to the factor 2 pi of the azimuth."""
    cosine = float(0.0)
    if lobe.kind == wp.static(RAYLEIGH):
        cosine = _rayleigh_cosine(u)
    elif lobe.kind == wp.static(FOURNIER_FORAND):
        cosine = _fournier_forand_cosine(_particles(lobe.first, lobe.second), u)
    else:
        cosine = phase_cosine(lobe.first, u)
    return cosine
