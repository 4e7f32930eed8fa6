"""Films thinner than light's waves are long: the colours of soap bubbles, oil and tempered steel.

The reflectance of a film on a facet is a series in the waves' detours between the film's two surfaces. For a channel of
the picture, a term of that series is the Fourier transform of the channel's sensitivity at the detour's length (Belcour
and Barla, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence", 2017). A table holds
these transforms; four terms of the series are taken.
"""

import functools
import math

import numpy as np
import warp as wp

from .color_matching import WAVELENGTHS, XYZ_TO_REC709, matching_functions
from .fresnel import F82_SCALE, F82_TERM, normal_reflectance

FILM_LEAST = 0.1  # [nm]; a thinner film counts as none
_COUNT = 512  # entries of the table for each channel
_DETOUR_LARGEST = 6e4 / (2 * math.pi)  # detour of the last entry [nm]; light of all wavelengths is mixed there
_TERMS = 3  # terms of the series after the constant one


@functools.cache
def load_film() -> np.ndarray:
    """Fourier transforms (real, imaginary) of the channels' sensitivities, float32, shape [3, count, 2].

    Entries have even steps of the detour, from 0 to `_DETOUR_LARGEST` [nm].
    """
    fine = np.arange(WAVELENGTHS[0], WAVELENGTHS[-1], 0.25)
    channels = matching_functions() @ np.array(XYZ_TO_REC709).T
    sensitivity = np.stack([np.interp(fine, WAVELENGTHS, channel) for channel in channels.T])
    sensitivity /= sensitivity.sum(1, keepdims=True)
    detours = np.linspace(0, _DETOUR_LARGEST, _COUNT)
    transforms = np.exp(-2j * np.pi * detours[:, None] / fine) @ sensitivity.T
    return np.stack([transforms.real.T, transforms.imag.T], -1).astype(np.float32)


@wp.struct
class _Surface:
    """Reflection by one of a film's surfaces, of light polarised across (s) and along (p) the plane of incidence."""

    s: float  # reflectances
    p: float
    phase_s: wp.vec2  # (cosine, sine) of the phase shift
    phase_p: wp.vec2
    cosine: float  # cosine of the refracted light; 0 where all is reflected


@wp.func
def _sign(x: float) -> float:
    return wp.where(x >= 0.0, 1.0, -1.0)


@wp.func
def _dielectric_surface(cosine: float, eta: float) -> _Surface:
    """The surface between two dielectrics; `eta` is the far side's index over the near side's."""
    surface = _Surface()
    surface.s = 1.0
    surface.p = 1.0
    surface.phase_s = wp.vec2(1.0, 0.0)
    surface.phase_p = wp.vec2(1.0, 0.0)
    square = eta * eta - (1.0 - cosine * cosine)
    if square > 0.0:
        behind = wp.sqrt(square) / eta
        s = (cosine - eta * behind) / (cosine + eta * behind)
        p = (eta * cosine - behind) / (eta * cosine + behind)
        surface.s = s * s
        surface.p = p * p
        surface.phase_s = wp.vec2(_sign(s), 0.0)
        surface.phase_p = wp.vec2(_sign(p), 0.0)
        surface.cosine = behind
    return surface


@wp.func
def _unit2(v: wp.vec2) -> wp.vec2:
    length = wp.length(v)
    if length > 0.0:
        return v / length
    return wp.vec2(1.0, 0.0)


@wp.func
def _conductor_surface(cosine: float, film: float, n: float, k: float) -> _Surface:
    """The surface from the film (index `film`) to a conductor of index n + i k."""
    surface = _Surface()
    c2 = cosine * cosine
    film2 = film * film
    t1 = n * n - k * k - film2 * (1.0 - c2)
    t2 = wp.sqrt(t1 * t1 + 4.0 * n * n * k * k)
    u2 = wp.max(0.5 * (t2 + t1), 0.0)
    v2 = wp.max(0.5 * (t2 - t1), 0.0)
    u = wp.sqrt(u2)
    v = wp.sqrt(v2)
    less = film * cosine - u
    more = film * cosine + u
    surface.s = 1.0
    if more * more + v2 > 0.0:
        surface.s = (less * less + v2) / (more * more + v2)
    t3 = (n * n - k * k) * cosine
    t4 = 2.0 * n * k * cosine
    surface.p = 1.0
    below = (t3 + film * u) * (t3 + film * u) + (t4 + film * v) * (t4 + film * v)
    if below > 0.0:
        surface.p = ((t3 - film * u) * (t3 - film * u) + (t4 - film * v) * (t4 - film * v)) / below
    surface.phase_s = _unit2(wp.vec2(film2 * c2 - u2 - v2, -2.0 * film * cosine * v))
    whole = (n * n + k * k) * cosine
    surface.phase_p = _unit2(
        wp.vec2(whole * whole - film2 * (u2 + v2), 2.0 * film * cosine * (2.0 * n * k * u - (n * n - k * k) * v))
    )
    return surface


@wp.func
def _transform(table: wp.array3d(dtype=float), channel: int, detour: float) -> wp.vec2:
    x = wp.clamp(detour * wp.static(1.0 / _DETOUR_LARGEST), 0.0, 1.0) * wp.static(_COUNT - 1.0)
    i = wp.min(int(x), wp.static(_COUNT - 2))
    f = x - float(i)
    return wp.vec2(
        wp.lerp(table[channel, i, 0], table[channel, i + 1, 0], f),
        wp.lerp(table[channel, i, 1], table[channel, i + 1, 1], f),
    )


@wp.func
def _series(
    table: wp.array3d(dtype=float), channel: int, above: float, below: float, detour: float, phase: wp.vec2
) -> float:
    """Reflectance of one polarisation: the film's upper surface reflects `above`, its lower one `below`."""
    both = above * below
    through = (1.0 - above) * (1.0 - above) * below / wp.max(1.0 - both, 1.0e-7)
    root = wp.sqrt(both)
    total = through + above
    term = through - (1.0 - above)
    turned = phase
    for m in range(1, wp.static(_TERMS + 1)):
        term = term * root
        transform = _transform(table, channel, float(m) * detour)
        total += 2.0 * term * wp.dot(turned, transform)
        turned = wp.vec2(turned[0] * phase[0] - turned[1] * phase[1], turned[0] * phase[1] + turned[1] * phase[0])
    return total


@wp.func
def _film_channel(
    table: wp.array3d(dtype=float), channel: int, upper: _Surface, lower: _Surface, detour: float
) -> float:
    s = _series(table, channel, upper.s, lower.s, detour, -upper.phase_s[0] * lower.phase_s)
    p = _series(table, channel, upper.p, lower.p, detour, -upper.phase_p[0] * lower.phase_p)
    return wp.clamp(0.5 * (s + p), 0.0, 1.0)


@wp.func
def _film_index(thickness: float, index: float) -> float:
    """Index of a film of `thickness` [nm]; below 1 nm, where there is hardly one, it nears that of the side above."""
    if thickness < 1.0:
        share = wp.clamp(thickness, 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        return 1.0 + share * (index - 1.0)
    return index


# Films are long and called from many places of a kernel: inlined, they were three quarters of a surface's code
@wp.func(inline=False)
def film_on_dielectric(
    table: wp.array3d(dtype=float), thickness: float, index: float, eta: float, tint: wp.vec3, cosine: float
) -> wp.vec3:
    """Reflectance of a film of `thickness` [nm] and `index` on a dielectric of `eta`.

    Both indices are relative to the side of the light. `tint` multiplies the bare dielectric's reflectance at normal
    incidence, and by that, in part, the film's.
    """
    film = _film_index(thickness, index)
    upper = _dielectric_surface(cosine, film)
    if upper.cosine <= 0.0:
        return wp.vec3(1.0)
    lower = _dielectric_surface(upper.cosine, eta / film)
    if lower.cosine <= 0.0:
        return wp.vec3(1.0)
    detour = 2.0 * film * thickness * upper.cosine
    f0 = normal_reflectance(eta)
    reflectance = wp.vec3(0.0)
    for channel in range(3):
        f = _film_channel(table, channel, upper, lower, detour)
        if f0 > 1.0e-5 and f < 1.0:
            share = wp.min((1.0 - f) / (1.0 - f0), 1.0)
            f = wp.min(f * (1.0 + share * (wp.min(tint[channel], 1.0 / f0) - 1.0)), 1.0)
        reflectance[channel] = f
    return reflectance


@wp.func(inline=False)
def film_on_conductor(
    table: wp.array3d(dtype=float), thickness: float, index: float, n: wp.vec3, k: wp.vec3, cosine: float
) -> wp.vec3:
    """Reflectance of a film of `thickness` [nm] and `index` on a conductor of complex index n + i k."""
    film = _film_index(thickness, index)
    upper = _dielectric_surface(cosine, film)
    if upper.cosine <= 0.0:
        return wp.vec3(1.0)
    detour = 2.0 * film * thickness * upper.cosine
    reflectance = wp.vec3(0.0)
    for channel in range(3):
        lower = _conductor_surface(upper.cosine, film, n[channel], k[channel])
        reflectance[channel] = _film_channel(table, channel, upper, lower, detour)
    return reflectance


@wp.func(inline=False)
def film_on_f82(
    table: wp.array3d(dtype=float), thickness: float, index: float, f0: wp.vec3, tint: wp.vec3, cosine: float
) -> wp.vec3:
    """Reflectance of a film of `thickness` [nm] and `index` on a metal of `fresnel_f82`.

    Phase shifts are those of the conductor of Gulbrandsen, "Artist Friendly Metallic Fresnel" (2014), whose edge colour
    is the reflectance at 82 degrees. Reflectances under the film follow F82 from the reflectance at normal incidence
    that this index gives.
    """
    film = _film_index(thickness, index)
    upper = _dielectric_surface(cosine, film)
    if upper.cosine <= 0.0:
        return wp.vec3(1.0)
    detour = 2.0 * film * thickness * upper.cosine
    m = 1.0 - upper.cosine
    m5 = m * m * m * m * m
    reflectance = wp.vec3(0.0)
    for channel in range(3):
        edge = wp.clamp((f0[channel] + wp.static(F82_TERM) * (1.0 - f0[channel])) * tint[channel], 0.0, 1.0)
        r = wp.min(f0[channel], 0.999)
        root = wp.sqrt(r)
        n = wp.lerp((1.0 + root) / (1.0 - root), (1.0 - r) / (1.0 + r), edge)
        k = wp.sqrt(wp.max((r * (n + 1.0) * (n + 1.0) - (n - 1.0) * (n - 1.0)) / (1.0 - r), 0.0))
        lower = _conductor_surface(upper.cosine, film, n, k)
        x = n / film
        y2 = k * k / (film * film)
        f = ((x - 1.0) * (x - 1.0) + y2) / ((x + 1.0) * (x + 1.0) + y2)
        dip = wp.static(F82_SCALE) * (f + wp.static(F82_TERM) * (1.0 - f) - edge)
        f = wp.clamp(f + m5 * (1.0 - f) - dip * upper.cosine * m5 * m, 0.0, 1.0)
        lower.s = f
        lower.p = f
        reflectance[channel] = _film_channel(table, channel, upper, lower, detour)
    return reflectance
