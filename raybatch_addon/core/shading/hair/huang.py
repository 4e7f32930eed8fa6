"""Principled Hair by facets: a rough dielectric cylinder, round or elliptical, whose surface is made of GGX facets.

Huang, Hullin and Hanika 2022, "A Microfacet-based Hair Scattering Model". Light is reflected (R), passes (TT), or is
reflected inside once (TRT); what is reflected more often is a series that spreads as in Chiang et al. 2016. The paper
integrates over the facets at which light goes in and is reflected inside. Here these two are drawn once for a point of
the surface and a view of it, by numbers hashed from both. Given them every lobe has a value and a density in closed
form, of the facet at which light comes out; over the hits of a pixel the values have the paper's mean. The point of the
fibre is the one that was met, as in Cycles near the camera.

Names are as in the paper: wi is where light is seen from, gamma an angle around the ellipse. Values contain the cosine.

Fields of the record: `color` absorption in units of the radius, `roughness` alpha of the facets, `aspect` minor over
major axis, `film_ior` tilt of the scales [rad], `ior`, `edge` factors of R, TT and TRT, `normal` direction of the
major axis (0: across the view, as it is for round fibres).
"""

from __future__ import annotations

import warp as wp

from ...native.build import native_source
from ..bsdf.albedo import AlbedoTables, glass_albedo
from ..bsdf.fresnel import fresnel_dielectric
from ..bsdf.ggx import ggx_distribution, ggx_slope, reflected, refracted, sample_visible_normal
from ..bsdf.materials import ClosureRecord, ShadingFrame
from ..sampling import bitangent_of, tangent_of
from .chiang import HairDirection, longitudinal
from .fibre import cosine_of, fibre_frame

_MOST_OFFSET = 0.999  # of a point from the middle of the fibre, seen from wi
_PASSES_LEAST = 0.1  # of what some facets let out where their middle reflects all light, for the choice of a lobe


@wp.struct
class Fibre:
    """A fibre of facets seen from wi, and the facets at which light goes in and is reflected inside."""

    x: wp.vec3  # major axis; y along the fibre; z
    y: wp.vec3
    z: wp.vec3
    wi: wp.vec3  # this and what follows in these axes
    b: float  # minor axis, the major one is 1
    alpha: float
    eta: float
    # first surface: normals of its facets' middle, with scales and without, the facet, and what comes through it
    m1: wp.vec3
    n1: wp.vec3
    t1: float
    wt: wp.vec3
    gamma: float
    phi_t: float
    first: float  # factors of what goes in; 0: nothing does
    scale1: float
    # second surface
    gamma2: float
    m2: wp.vec3
    n2: wp.vec3
    passed: wp.vec3  # share that is not absorbed on the way there
    scale2: float
    wtr: wp.vec3  # where light comes from that was reflected there; 0: none is
    r2: float
    # third surface
    m3: wp.vec3
    n3: wp.vec3
    second: float  # factors of what is reflected
    passed2: wp.vec3
    scale3: float
    share: float  # of the seen fibre, what an angle around it is
    arc1: float  # lengths of the ellipse by that angle, at the three surfaces
    arc2: float
    arc3: float
    rest: wp.vec3  # what is reflected more often
    seen: wp.vec4  # energy of R, TT, TRT and the rest, about
    chance: wp.vec4


@wp.struct
class _Facet:
    value: float
    density: float


@wp.func_native(native_source("math/hash_vectors.h"))
def _hashed(a: wp.vec3, b: wp.vec3, salt: int) -> int: ...


@wp.func
def _number(a: wp.vec3, b: wp.vec3, salt: int) -> float:
    """A random number, 0 <= u < 1, of two directions."""
    return float(_hashed(a, b, salt)) * wp.static(2.0**-24)


@wp.func
def _direction(tilt: float, gamma: float, b: float) -> wp.vec3:
    """The normal at gamma, tilted along the fibre."""
    across = wp.normalize(wp.vec3(b * wp.sin(gamma), 0.0, wp.cos(gamma)))
    return wp.cos(tilt) * across + wp.vec3(0.0, wp.sin(tilt), 0.0)


@wp.func
def _to_phi(gamma: float, b: float) -> float:
    return wp.atan2(b * wp.sin(gamma), wp.cos(gamma))


@wp.func
def _way(a: float, c: float, b: float) -> float:
    """Distance of two points of the ellipse, in units of the radius."""
    x = wp.sin(a) - wp.sin(c)
    z = b * (wp.cos(a) - wp.cos(c))
    return wp.sqrt(x * x + z * z)


@wp.func
def _arc(gamma: float, b: float) -> float:
    s = wp.sin(gamma)
    return wp.sqrt(wp.max(1.0 - (1.0 - b * b) * s * s, 0.0))


@wp.func
def _absorbed(sigma: wp.vec3, w: wp.vec3, way: float) -> wp.vec3:
    """What is left of light behind a way across the fibre, that goes along w."""
    length = way / wp.max(cosine_of(w[1]), 1.0e-3)
    return wp.vec3(wp.exp(-sigma[0] * length), wp.exp(-sigma[1] * length), wp.exp(-sigma[2] * length))


@wp.func
def _lambda(alpha: float, cosine: float) -> float:
    return 0.5 * (ggx_slope(alpha, cosine) / wp.max(cosine, 1.0e-6) - 1.0)


@wp.func
def _shadowing(alpha: float, cos_o: float, cos_i: float) -> float:
    return 1.0 / (1.0 + _lambda(alpha, cos_o) + _lambda(alpha, cos_i))


@wp.func
def _left(alpha: float, cos_i: float, cos_o: float) -> float:
    """The shadowing of both directions over that of the first."""
    a = _lambda(alpha, cos_i)
    return (1.0 + a) / (1.0 + a + _lambda(alpha, cos_o))


@wp.func
def _sees(v: wp.vec3, m: wp.vec3, n: wp.vec3, h: wp.vec3) -> bool:
    return wp.dot(v, h) > 0.0 and wp.dot(v, m) > 0.0 and wp.dot(v, n) > 0.0


@wp.func
def _facet_of(m: wp.vec3, w: wp.vec3, alpha: float, u: wp.vec2) -> wp.vec3:
    """A facet around m that is seen from w."""
    s = tangent_of(m)
    t = bitangent_of(m)
    local = wp.vec3(wp.dot(w, s), wp.dot(w, t), wp.max(wp.dot(w, m), 1.0e-5))
    h = sample_visible_normal(local, alpha, alpha, u)
    return h[0] * s + h[1] * t + h[2] * m


@wp.func
def _distribution(alpha: float, m: wp.vec3, h: wp.vec3) -> float:
    c = wp.cross(m, h)
    return ggx_distribution(alpha, wp.min(wp.dot(c, c), 1.0))


@wp.func
def _mean(v: wp.vec3) -> float:
    return (v[0] + v[1] + v[2]) * wp.static(1.0 / 3.0)


@wp.func
def fibre_of(
    closures: wp.array(dtype=ClosureRecord), c: int, albedo: AlbedoTables, frame: ShadingFrame, wo: wp.vec3
) -> Fibre:
    """The fibre that closure `c` is, seen from `wo`."""
    f = Fibre()
    around = fibre_frame(closures[c].tangent, frame, wo)
    f.b = closures[c].aspect
    f.alpha = closures[c].roughness
    f.eta = closures[c].ior
    sigma = closures[c].color
    tilt = closures[c].film_ior
    factors = closures[c].edge
    f.y = around.along
    f.x = around.beside
    major = closures[c].normal
    major = major - wp.dot(major, f.y) * f.y
    if f.b != 1.0:
        if wp.dot(major, major) > 1.0e-12:
            f.x = wp.normalize(major)
        else:
            f.x = tangent_of(f.y)
    f.z = wp.cross(f.x, f.y)
    f.wi = wp.vec3(wp.dot(wo, f.x), wp.dot(wo, f.y), wp.dot(wo, f.z))
    cos_theta = wp.max(cosine_of(f.wi[1]), 1.0e-4)
    sin_phi = f.wi[0] / cos_theta
    cos_phi = f.wi[2] / cos_theta
    radius = wp.sqrt(wp.max(1.0 - (1.0 - f.b * f.b) * sin_phi * sin_phi, 1.0e-6))
    offset = wp.clamp(around.offset / radius, -wp.static(_MOST_OFFSET), wp.static(_MOST_OFFSET))
    f.gamma = wp.atan2(cos_phi, -f.b * sin_phi) - wp.acos(-offset)
    f.m1 = _direction(tilt, f.gamma, f.b)
    f.n1 = _direction(0.0, f.gamma, f.b)
    f.share = 1.0 / wp.max(cos_phi * wp.cos(f.gamma) + f.b * sin_phi * wp.sin(f.gamma), 1.0e-3)
    f.share = f.share / cos_theta
    f.arc1 = _arc(f.gamma, f.b)
    cos_i1 = wp.dot(f.m1, f.wi)
    f.scale1 = 1.0 / glass_albedo(albedo, wp.sqrt(f.alpha), f.eta, wp.max(cos_i1, 0.0))
    wn = frame.geometric_normal
    inverse = 1.0 / f.eta
    if cos_i1 > 0.0 and wp.dot(f.n1, f.wi) > 0.0:
        h1 = _facet_of(f.m1, f.wi, f.alpha, wp.vec2(_number(wo, wn, 1), _number(wo, wn, 2)))
        r1 = fresnel_dielectric(wp.dot(f.wi, h1), f.eta)
        f.t1 = 1.0 - r1
        f.seen[0] = factors[0] * fresnel_dielectric(wp.dot(f.wi, f.m1), f.eta)
        f.wt = refracted(f.wi, h1, f.eta)
        back = -f.wt
        f.phi_t = wp.atan2(f.wt[0], f.wt[2])
        f.gamma2 = 2.0 * _to_phi(f.phi_t, f.b) - f.gamma
        f.m2 = _direction(-tilt, f.gamma2, f.b)
        f.n2 = _direction(0.0, f.gamma2, f.b)
        cos_o1 = wp.dot(back, f.m1)
        cos_i2 = wp.dot(back, f.m2)
        entered = _sees(f.wi, f.m1, f.n1, h1) and cos_o1 > 0.0 and wp.dot(back, f.n1) > 0.0 and wp.dot(back, h1) > 0.0
        if entered and cos_i2 > 0.0 and wp.dot(back, f.n2) > 0.0 and f.t1 > 0.0:
            f.first = f.t1 * f.scale1 * _left(f.alpha, cos_i1, cos_o1) * cos_i1 / cos_o1 * f.share
            f.passed = _absorbed(sigma, f.wt, _way(f.gamma, f.gamma2 + wp.PI, f.b))
            f.scale2 = 1.0 / glass_albedo(albedo, wp.sqrt(f.alpha), inverse, cos_i2)
            f.arc2 = _arc(f.gamma2, f.b)
            h2 = _facet_of(f.m2, back, f.alpha, wp.vec2(_number(wo, wn, 3), _number(wo, wn, 4)))
            f.r2 = fresnel_dielectric(wp.dot(back, h2), inverse)
            passes = wp.max(1.0 - fresnel_dielectric(cos_i2, inverse), wp.static(_PASSES_LEAST))
            f.seen[1] = factors[1] * f.t1 * passes * _mean(f.passed)
            f.wtr = -reflected(back, h2)
            out2 = -f.wtr
            cos_o2 = wp.dot(f.m2, out2)
            if _sees(back, f.m2, f.n2, h2) and _sees(out2, f.m2, f.n2, h2):
                phi_tr = wp.atan2(f.wtr[0], f.wtr[2])
                gamma3 = f.gamma - 2.0 * (_to_phi(f.phi_t, f.b) - _to_phi(phi_tr, f.b)) + wp.PI
                f.m3 = _direction(-tilt, gamma3, f.b)
                f.n3 = _direction(0.0, gamma3, f.b)
                f.second = f.r2 * f.scale2 * _left(f.alpha, cos_i2, cos_o2) * cos_i2 / cos_o2
                f.passed2 = _absorbed(sigma, f.wtr, _way(f.gamma2, gamma3, f.b))
                f.arc3 = _arc(gamma3, f.b)
                cos_i3 = wp.dot(f.m3, f.wtr)
                if cos_i3 > 0.0 and wp.dot(f.n3, f.wtr) > 0.0:
                    f.scale3 = 1.0 / glass_albedo(albedo, wp.sqrt(f.alpha), inverse, cos_i3)
                    t3 = wp.max(1.0 - fresnel_dielectric(cos_i3, inverse), wp.static(_PASSES_LEAST))
                    f.seen[2] = factors[2] * f.t1 * f.r2 * t3 * _mean(wp.cw_mul(f.passed, f.passed2))
                    # what stays inside once more, and from there on a series of means of what there was before
                    h3 = _facet_of(f.m3, f.wtr, f.alpha, wp.vec2(_number(wo, wn, 5), _number(wo, wn, 6)))
                    r3 = fresnel_dielectric(wp.dot(f.wtr, h3), inverse)
                    cos_o3 = wp.dot(f.m3, reflected(f.wtr, h3))
                    if cos_o3 > 0.0:
                        inside = f.t1 * f.scale1 * _left(f.alpha, cos_i1, cos_o1)
                        inside = inside * f.r2 * f.scale2 * _left(f.alpha, cos_i2, cos_o2)
                        inside = inside * r3 * f.scale3 * _left(f.alpha, cos_i3, cos_o3)
                        passes = wp.max(1.0 - 0.5 * (f.r2 + r3), 1.0e-5)
                        for k in range(3):
                            both = f.passed[k] * f.passed2[k]
                            a = wp.sqrt(both)
                            f.rest[k] = inside * both * a * passes / (1.0 - a * (1.0 - passes))
                        f.seen[3] = _mean(f.rest)
    total = f.seen[0] + f.seen[1] + f.seen[2] + f.seen[3]
    if total > 0.0:
        for k in range(4):
            # lobes that are faint in the middle may not be so aside
            f.chance[k] = wp.where(f.seen[k] > 0.0, f.seen[k] / total + 0.05, 0.0)
        f.chance = f.chance / (f.chance[0] + f.chance[1] + f.chance[2] + f.chance[3])
    return f


@wp.func
def fibre_albedo(f: Fibre) -> float:
    """Share of light that leaves, about; its factors included."""
    return f.seen[0] + f.seen[1] + f.seen[2] + f.seen[3]


@wp.func
def _out(f: Fibre, w: wp.vec3, m: wp.vec3, n: wp.vec3, scale: float, wo: wp.vec3) -> _Facet:
    """Light from w, inside, that facets around m let out towards wo."""
    found = _Facet()
    inverse = 1.0 / f.eta
    h = w + inverse * wo
    if f.eta < 1.0:
        h = -h
    size = wp.length(h)
    if size < 1.0e-6:
        return found
    h = h / size
    cos_i = wp.dot(w, m)
    cos_o = -wp.dot(wo, m)
    hi = wp.dot(h, w)
    ho = -wp.dot(h, wo)
    if cos_i <= 0.0 or hi <= 0.0 or ho <= 0.0 or wp.dot(m, h) <= 0.0:
        return found
    d = _distribution(f.alpha, m, h) * hi * ho * inverse * inverse / (size * size)
    found.density = d / (cos_i * (1.0 + _lambda(f.alpha, cos_i)))
    if cos_o > 0.0 and wp.dot(wo, n) < 0.0:
        transmitted = (1.0 - fresnel_dielectric(hi, inverse)) * scale
        found.value = transmitted * d * _shadowing(f.alpha, cos_i, cos_o)
    return found


@wp.func
def facet_hair_value(closures: wp.array(dtype=ClosureRecord), c: int, f: Fibre, direction: wp.vec3) -> wp.vec4:
    """(f |cos|, density) towards the unit `direction`."""
    wo = wp.vec3(wp.dot(direction, f.x), wp.dot(direction, f.y), wp.dot(direction, f.z))
    factors = closures[c].edge
    value = wp.vec3(0.0)
    density = float(0.0)
    cos_i = wp.dot(f.m1, f.wi)
    if f.chance[0] > 0.0:
        h = wp.normalize(f.wi + wo)
        if wp.dot(f.wi, h) > 0.0 and wp.dot(f.m1, h) > 0.0:
            d = _distribution(f.alpha, f.m1, h)
            density += f.chance[0] * 0.25 * d / (cos_i * (1.0 + _lambda(f.alpha, cos_i)))
            cos_o = wp.dot(wo, f.m1)
            if cos_o > 0.0 and wp.dot(wo, f.n1) > 0.0:
                r = fresnel_dielectric(wp.dot(f.wi, h), f.eta) * f.scale1 * _shadowing(f.alpha, cos_i, cos_o)
                value += wp.vec3(factors[0] * 0.25 * r * d * f.arc1 * f.share)
    if f.first > 0.0:
        if f.chance[1] > 0.0:
            out = _out(f, -f.wt, f.m2, f.n2, f.scale2, wo)
            density += f.chance[1] * out.density
            value += (factors[1] * f.first * out.value * f.arc2) * f.passed
        if f.chance[2] > 0.0:
            out = _out(f, f.wtr, f.m3, f.n3, f.scale3, wo)
            density += f.chance[2] * out.density
            both = wp.cw_mul(f.passed, f.passed2)
            value += (factors[2] * f.first * f.second * out.value * f.arc3) * both
        if f.chance[3] > 0.0:
            spread = longitudinal(wo[1], cosine_of(wo[1]), f.wi[1], cosine_of(f.wi[1]), 4.0 * f.alpha) / wp.TAU
            density += f.chance[3] * spread
            value += spread * f.rest
    return wp.vec4(value[0], value[1], value[2], density)


@wp.func
def sample_facet_hair(f: Fibre, u_lobe: float, u: wp.vec2) -> HairDirection:
    """A direction with the density of `facet_hair_value`; none where light is lost."""
    found = HairDirection()
    left = float(u_lobe)
    p = int(3)
    for k in range(3):
        if p == 3:
            if left < f.chance[k]:
                p = k
            else:
                left = left - f.chance[k]
    wo = wp.vec3(0.0)
    if p == 0 and f.chance[0] > 0.0:
        h = _facet_of(f.m1, f.wi, f.alpha, u)
        wo = reflected(f.wi, h)
    if p == 1:
        h = _facet_of(f.m2, -f.wt, f.alpha, u)
        wo = refracted(-f.wt, h, 1.0 / f.eta)
    if p == 2:
        h = _facet_of(f.m3, f.wtr, f.alpha, u)
        wo = refracted(f.wtr, h, 1.0 / f.eta)
    if p == 3 and f.chance[3] > 0.0:
        rest = wp.clamp(left / f.chance[3], 1.0e-5, 1.0)
        variance = 4.0 * f.alpha
        cosine = 1.0 + variance * wp.log(rest + (1.0 - rest) * wp.exp(-2.0 / variance))
        s = -cosine * f.wi[1] + cosine_of(cosine) * wp.cos(wp.TAU * u[1]) * cosine_of(f.wi[1])
        s = wp.clamp(s, -1.0, 1.0)
        c = cosine_of(s)
        wo = wp.vec3(c * wp.sin(wp.TAU * u[0]), s, c * wp.cos(wp.TAU * u[0]))
    if wp.dot(wo, wo) > 0.5:
        found.direction = wp.normalize(wo[0] * f.x + wo[1] * f.y + wo[2] * f.z)
    return found
