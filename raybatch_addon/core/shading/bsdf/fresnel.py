"""Reflectance of a microfacet: Fresnel's equations, and the models that stand for them.

`cosine` in [0, 1] is the cosine between a direction and the facet's normal, on the near side. `eta` is the index of
refraction of the far side relative to the near one.
"""

import warp as wp

# F82-tint states the reflectance at the cosine 1/7 (82 degrees); this is (1 - cos)^5 there
F82_TERM = (6.0 / 7.0) ** 5
F82_SCALE = 7.0 / (6.0 / 7.0) ** 6  # one over cos (1 - cos)^6


@wp.func
def fresnel_dielectric(cosine: float, eta: float) -> float:
    """Reflectance of unpolarised light at a smooth dielectric, in [0, 1]; 1 at total internal reflection.

    `cosine` in [0, 1] on the near side. The difference g - c of the textbook form (Cook and Torrance
    1982) is taken as (eta^2 - 1) / (g + c), which is exact to rounding for every eta, 1 included.
    """
    m = (eta - 1.0) * (eta + 1.0)
    if m == 0.0:
        return 0.0
    c = wp.min(wp.abs(cosine), 1.0)
    g2 = m + c * c
    if g2 <= 0.0:
        return 1.0
    g = wp.sqrt(g2)
    s = m / ((g + c) * (g + c))
    p = s * (c * (g + c) - 1.0) / (c * m / (g + c) + 1.0)
    return wp.min(0.5 * (s * s + p * p), 1.0)


@wp.func
def normal_reflectance(eta: float) -> float:
    """Reflectance of a dielectric at normal incidence."""
    r = (eta - 1.0) / (eta + 1.0)
    return r * r


@wp.func
def tinted_dielectric(reflectance: float, eta: float, tint: wp.vec3) -> wp.vec3:
    """A dielectric's `reflectance`, multiplied by `tint` at normal incidence and kept at grazing angles.

    The map is linear in the reflectance, so that it takes the mean reflectance to the mean of the tinted one. White
    changes nothing, to the bit.
    """
    f0 = normal_reflectance(eta)
    most = wp.vec3(1.0 / wp.max(f0, 1.0e-20))
    tinted = wp.vec3(reflectance) + (f0 * (1.0 - reflectance) / (1.0 - f0)) * (wp.min(tint, most) - wp.vec3(1.0))
    return wp.min(wp.max(tinted, wp.vec3(0.0)), wp.vec3(1.0))


@wp.func
def f82_dip(f0: wp.vec3, tint: wp.vec3) -> wp.vec3:
    """Factor of cos (1 - cos)^6 in F82-tint: how far it falls below Schlick's curve at grazing angles."""
    white = wp.vec3(1.0)
    return wp.static(F82_SCALE) * wp.cw_mul(f0 + wp.static(F82_TERM) * (white - f0), white - tint)


@wp.func
def fresnel_f82(f0: wp.vec3, tint: wp.vec3, cosine: float) -> wp.vec3:
    """F82-tint's reflectance, in [0, 1]: Schlick's curve from `f0` to white, multiplied by `tint` at 82 degrees.

    Kutz, Hasan and Edmondson, "Novel aspects of the Adobe Standard Material", 2021, section 2.
    """
    m = 1.0 - wp.clamp(cosine, 0.0, 1.0)
    m2 = m * m
    m5 = m2 * m2 * m
    f = f0 + m5 * (wp.vec3(1.0) - f0) - (cosine * m5 * m) * f82_dip(f0, tint)
    return wp.min(wp.max(f, wp.vec3(0.0)), wp.vec3(1.0))


@wp.func
def f82_average(f0: wp.vec3, tint: wp.vec3) -> wp.vec3:
    """Cosine-weighted mean of `fresnel_f82` over the hemisphere.

    The means of (1 - cos)^5 and cos (1 - cos)^6 are 1/21 and 1/126.
    """
    mean = f0 + (wp.vec3(1.0) - f0) / 21.0 - f82_dip(f0, tint) / 126.0
    return wp.min(wp.max(mean, wp.vec3(0.0)), wp.vec3(1.0))


@wp.func
def _conductor(n: float, k: float, cosine: float) -> float:
    c2 = cosine * cosine
    nk2 = n * n + k * k
    t1 = n * n - k * k - (1.0 - c2)
    t2 = wp.sqrt(t1 * t1 + 4.0 * n * n * k * k)
    u = wp.sqrt(wp.max(0.5 * (t2 + t1), 0.0))
    s_above = t2 + c2 - 2.0 * cosine * u
    s_below = t2 + c2 + 2.0 * cosine * u
    # p: light polarised in the plane of incidence, relative to s, light polarised across it
    p_above = c2 * t2 + (1.0 - c2) * (1.0 - c2) - 2.0 * cosine * u * (1.0 - c2)
    p_below = c2 * t2 + (1.0 - c2) * (1.0 - c2) + 2.0 * cosine * u * (1.0 - c2)
    if s_below <= 0.0 or nk2 <= 0.0:
        return 1.0
    rs = s_above / s_below
    if p_below <= 0.0:
        return rs
    return wp.clamp(0.5 * rs * (1.0 + p_above / p_below), 0.0, 1.0)


@wp.func
def fresnel_conductor(index: wp.vec3, extinction: wp.vec3, cosine: float) -> wp.vec3:
    """Reflectance of unpolarised light at a conductor of complex index n + i k, by channel.

    Born and Wolf, "Principles of Optics", section 14.4.
    """
    return wp.vec3(
        _conductor(index[0], extinction[0], cosine),
        _conductor(index[1], extinction[1], cosine),
        _conductor(index[2], extinction[2], cosine),
    )


@wp.func
def conductor_average(index: wp.vec3, extinction: wp.vec3) -> wp.vec3:
    """Cosine-weighted mean of `fresnel_conductor` over the hemisphere, approximate.

    It is the mean of the F82 model that has the same reflectances at 0 and 82 degrees.
    """
    f0 = fresnel_conductor(index, extinction, 1.0)
    schlick = f0 + wp.static(F82_TERM) * (wp.vec3(1.0) - f0)
    dip = wp.static(F82_SCALE) * (schlick - fresnel_conductor(index, extinction, wp.static(1.0 / 7.0)))
    mean = f0 + (wp.vec3(1.0) - f0) / 21.0 - dip / 126.0
    return wp.min(wp.max(mean, wp.vec3(0.0)), wp.vec3(1.0))
