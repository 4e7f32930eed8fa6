"""Light below surfaces: media derived from the colours that they show, and the sampling of random walks through them.

A medium is given by its extinction [1/m] and its single-scattering albedo, by channel, and by the mean cosine g of its
phase function (Henyey and Greenstein's). A step may be sampled by any channel, and by the phase function or by a guide
towards the surface. All these strategies are weighted together (balance heuristic), so that none of them biases a walk.

The model is that of Cycles (`integrator/subsurface_random_walk.h`), after the papers that it names.
"""

import warp as wp

# Most steps of a walk; light still inside after them is lost
STEPS_MOST = 256
# Walks whose throughput is below this in all channels end
THROUGHPUT_LEAST = 1e-6
# From this step on scattering counts as isotropic, with as much forward transport (similarity)
ANISOTROPIC_STEPS = 10
_ALBEDO_MOST = wp.constant(0.999999)
# Darker media scatter as one of this albedo does; a factor takes the rest of their light
_ALBEDO_LEAST = wp.constant(0.2)


@wp.func
def medium_albedo(color: float, g: float) -> float:
    """Single-scattering albedo of a half-space that reflects `color` in [0, 1].

    D'Eon, "A Hitchhiker's Guide to Multiple Scattering", equation 53.7.
    """
    root = 4.09712 + 4.20863 * color - wp.sqrt(9.59217 + 41.6808 * color + 17.7126 * color * color)
    square = root * root
    return wp.clamp((1.0 - square) / (1.0 - g * square), 0.0, _ALBEDO_MOST)


@wp.func
def _polynomial(low: wp.vec4, high: wp.vec4, x: float) -> float:
    """Value at `x` of the polynomial with these coefficients, lowest powers first."""
    x2 = x * x
    above = high[0] + high[1] * x + x2 * (high[2] + high[3] * x)
    return low[0] + low[1] * x + x2 * (low[2] + low[3] * x) + x2 * x2 * above


@wp.func
def fitted_albedo(color: float, g: float) -> float:
    """Single-scattering albedo by the fit of Chiang, Kutz and Burley, for `g` in [0, 0.9] as Cycles has it.

    "Practical and Controllable Subsurface Scattering for Production Path Tracing", 2016.
    """
    a = _polynomial(
        wp.vec4(1.8260523782, -1.28451056436, -1.79904629312, 9.19393289202),
        wp.vec4(-22.8215585862, 32.0234874259, -23.6264803333, 7.21067002658),
        g,
    )
    b = _polynomial(
        wp.vec4(0.0, 31.1491581433, -201.847017512, 841.576016723),
        wp.vec4(-2018.09288505, 2731.71560286, -1935.41424244, 559.009054474),
        g,
    )
    b = 4.98511194385 + 0.127355959438 * wp.exp(b)
    c = _polynomial(
        wp.vec4(1.09686102424, -0.394704063468, 1.05258115941, -8.83963712726),
        wp.vec4(28.8643230661, -46.8802913581, 38.5402837518, -12.7181042538),
        g,
    )
    d = _polynomial(
        wp.vec4(0.496310210422, 0.360146581622, -2.15139309747, 17.8896899217),
        wp.vec4(-55.2984010333, 82.065982243, -58.5106008578, 15.8478295021),
        g,
    )
    e = _polynomial(
        wp.vec4(0.0, 76.7316253952, -594.356773233, 2448.8834203),
        wp.vec4(-5576.68528998, 7116.60171912, -4763.54467887, 1303.5318055),
        g,
    )
    e = 4.23190299701 + 0.00310603949088 * wp.exp(e)
    f = _polynomial(
        wp.vec4(2.40602999408, -2.51814844609, 9.18494908356, -79.2191708682),
        wp.vec4(259.082868209, -403.613804597, 302.85712436, -87.4370473567),
        g,
    )
    blend = wp.sqrt(wp.sqrt(color))
    fitted = (1.0 - blend) * a * wp.pow(wp.atan(b * color), c) + blend * d * wp.pow(wp.atan(e * color), f)
    return wp.clamp(fitted, 0.0, _ALBEDO_MOST)


@wp.func
def dipole_albedo(color: float, ior: float) -> float:
    """Reduced albedo of a dipole that reflects `color` below a surface of index `ior`, by bisection.

    Jensen et al., "A Practical Model for Subsurface Light Transport", 2001.
    """
    if color < 1.0e-4:
        return 0.0
    if color >= 0.995:
        return _ALBEDO_MOST
    inverse = 1.0 / ior
    diffuse = inverse * (0.71 - 1.44 * inverse) + 0.668 + 0.0636 * ior
    third = (4.0 / 3.0) * (1.0 + diffuse) / (1.0 - diffuse)
    low = float(0.0)
    high = float(1.0)
    middle = float(0.5)
    for _i in range(12):
        middle = 0.5 * (low + high)
        s = wp.sqrt(3.0 * (1.0 - middle))
        if 0.5 * middle * (1.0 + wp.exp(-third * s)) * wp.exp(-s) < color:
            low = middle
        else:
            high = middle
    return middle


@wp.func
def lifted_albedo(albedo: float) -> wp.vec2:
    """(an albedo large enough to guide walks, factor of a walk's throughput that makes up for it)."""
    if albedo < _ALBEDO_LEAST:
        return wp.vec2(_ALBEDO_LEAST, albedo / _ALBEDO_LEAST)
    return wp.vec2(albedo, 1.0)


# --- steps of a walk


@wp.struct
class Medium:
    """The medium as light meets it in one step."""

    extinction: wp.vec3  # [1/m]
    scattering: wp.vec3
    g: float  # mean cosine of the phase function
    guided: float  # share of directions that are guided towards a surface


@wp.func
def medium_of(extinction: wp.vec3, albedo: wp.vec3, g: float, step: int) -> Medium:
    """The medium that step number `step` of a walk meets; the first step is 1."""
    medium = Medium()
    medium.extinction = extinction
    medium.scattering = wp.cw_mul(extinction, albedo)
    medium.g = g
    medium.guided = 1.0 - wp.max(0.5, wp.pow(wp.abs(g), 0.125))
    if step > wp.static(ANISOTROPIC_STEPS):
        absorbed = extinction - medium.scattering
        medium.scattering = (1.0 - g) * medium.scattering
        medium.extinction = absorbed + medium.scattering
        medium.g = 0.0
        medium.guided = 0.75
    return medium


@wp.func
def channel_shares(throughput: wp.vec3, albedo: wp.vec3) -> wp.vec3:
    """Probability that each channel decides a step's length."""
    shares = wp.cw_mul(throughput, albedo)
    total = shares[0] + shares[1] + shares[2]
    if total > 1.0e-30:
        return shares / total
    return wp.vec3(1.0 / 3.0)


@wp.func
def sampled_length(extinction: wp.vec3, stretching: float, shares: wp.vec3, u_channel: float, u: float) -> float:
    """Length of a step [m]; `stretching` multiplies the extinction."""
    chosen = extinction[2]
    if u_channel < shares[0]:
        chosen = extinction[0]
    elif u_channel < shares[0] + shares[1]:
        chosen = extinction[1]
    return -wp.log(1.0 - u) / (chosen * stretching)


@wp.func
def transmittance(extinction: wp.vec3, length: float) -> wp.vec3:
    """Share of light that passes through `length` [m], by channel."""
    return wp.vec3(wp.exp(-extinction[0] * length), wp.exp(-extinction[1] * length), wp.exp(-extinction[2] * length))


@wp.func
def length_density(extinction: wp.vec3, length: float, hit: bool) -> wp.vec3:
    """Density of a step's length by channel [1/m].

    Where the step `hit` a surface it is the probability of a step at least as long.
    """
    passed = transmittance(extinction, length)
    if hit:
        return passed
    return wp.cw_mul(extinction, passed)


@wp.func
def phase_density(g: float, cosine: float) -> float:
    """Henyey and Greenstein's phase function [1/sr]."""
    a = wp.abs(g)
    # terms of one sign: 1 + g^2 - 2 g cosine has no digit left at the peak of a `g` near 1
    below = (1.0 - a) * (1.0 - a) + 2.0 * a * (1.0 - wp.where(g < 0.0, -cosine, cosine))
    below = wp.max(below, 1.0e-12)
    return (1.0 - a) * (1.0 + a) / (4.0 * wp.PI * below * wp.sqrt(below))


@wp.func
def phase_cosine(g: float, u: float) -> float:
    """A cosine of density `phase_density`, up to the factor 2 pi of the azimuth."""
    a = wp.abs(g)
    share = wp.where(g < 0.0, u, 1.0 - u)  # of what is nearer to the peak
    middle = (1.0 - a) + 2.0 * a * (1.0 - share)
    distance = (1.0 - a) * share * ((1.0 - a) * (1.0 + a) / middle + (1.0 - a)) / middle  # from it, 1 - |cosine| there
    return wp.clamp(wp.where(g < 0.0, distance - 1.0, 1.0 - distance), -1.0, 1.0)


@wp.func
def diffusion_length(albedo: wp.vec3) -> float:
    """Distance that light of the least absorbed channel diffuses, in mean free paths; above 1.

    D'Eon and Krivanek, "Zero-Variance Theory for Efficient Subsurface Scattering", 2020, equation 67.
    """
    a = wp.max(albedo[0], wp.max(albedo[1], albedo[2]))
    return 1.0 / wp.sqrt(1.0 - wp.pow(a, 2.44294 - 0.0215813 * a + 0.578637 / a))


@wp.func
def guide_logarithm(diffusion: float) -> float:
    """The logarithm that normalises `guide_density`, an argument of that function and of `guide_cosine`."""
    return wp.log((diffusion + 1.0) / (diffusion - 1.0))


@wp.func
def guide_density(diffusion: float, logarithm: float, cosine: float) -> float:
    """Dwivedi's density of directions towards a surface [1/sr], by their `cosine` to its normal.

    Meng, Hanika and Dachsbacher, "Improving the Dwivedi Sampling Scheme", 2016, equation 9.
    """
    return 1.0 / (wp.TAU * (diffusion - cosine) * logarithm)


@wp.func
def guide_cosine(diffusion: float, logarithm: float, u: float) -> float:
    """A cosine to the surface's normal of density `guide_density`, up to the factor 2 pi of the azimuth."""
    return wp.clamp(diffusion - (diffusion + 1.0) * wp.exp(-u * logarithm), -1.0, 1.0)


@wp.func
def away_share(thickness: float, depth: float, diffusion: float) -> float:
    """Share of guided directions that go to the far side of an object, at a `depth` [m] below its near side.

    `thickness` [m] is the object's; the share is 0 where it is negative.
    """
    if thickness < 0.0:
        return 0.0
    return 1.0 / (1.0 + wp.exp((thickness - 2.0 * wp.clamp(depth, 0.0, thickness)) / diffusion))
