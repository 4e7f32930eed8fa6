"""Warps from the unit square to shapes, and the pixel filter.

Points of the unit square are in [0, 1) with 24 bits. Warps centre them in their cells of 2**-24, so that no warp meets
the border of the square, where directions would degenerate.
"""

import functools
import math

import numpy as np
import warp as wp

from .sequences.keys import ULP_BELOW_ONE

FILTER_TABLE_SIZE = 1024


@wp.func
def _centred(u: float) -> float:
    """A number in (-1, 1) for one in [0, 1): the middle of its 24-bit cell, exact in float32, never 0 nor an end."""
    return (2.0 * u - 1.0) + ULP_BELOW_ONE


@wp.func
def sample_disk(u: wp.vec2) -> wp.vec2:
    """A uniform point of the open unit disk, keeping neighbours (Shirley and Chiu 1997). Density 1 / pi."""
    x = _centred(u[0])
    y = _centred(u[1])
    radius = x
    angle = (wp.PI / 4.0) * (y / x)
    if wp.abs(y) > wp.abs(x):
        radius = y
        angle = (wp.PI / 2.0) - (wp.PI / 4.0) * (x / y)
    return radius * wp.vec2(wp.cos(angle), wp.sin(angle))


@wp.func
def sample_cosine_hemisphere(u: wp.vec2) -> wp.vec3:
    """Unit direction about +Z with density z / pi (Malley); z >= 2**-11.5, never 0."""
    rho = wp.max(wp.abs(_centred(u[0])), wp.abs(_centred(u[1])))
    d = sample_disk(u)
    # from the radius before rotation: 1 - |d|^2 would lose the low bits near the horizon
    return wp.vec3(d[0], d[1], wp.sqrt((1.0 - rho) * (1.0 + rho)))


@wp.func
def sample_sphere(u: wp.vec2) -> wp.vec3:
    """Uniform unit direction. Density 1 / (4 pi)."""
    r = 2.0 * wp.sqrt(u[0] * (1.0 - u[0]))
    phi = wp.TAU * u[1]
    return wp.vec3(r * wp.cos(phi), r * wp.sin(phi), 1.0 - 2.0 * u[0])


@wp.func
def sample_cone(u: wp.vec2, one_minus_cos: float) -> wp.vec3:
    """Uniform unit direction within a cone about +Z; density `cone_pdf`.

    `one_minus_cos` = 1 - cos(half angle) in [0, 2], as 2 sin^2(half angle / 2), which keeps its
    precision in the thinnest cones.
    """
    v = u[0] * one_minus_cos
    r = wp.sqrt(wp.max(v * (2.0 - v), 0.0))
    phi = wp.TAU * u[1]
    return wp.vec3(r * wp.cos(phi), r * wp.sin(phi), 1.0 - v)


@wp.func
def cone_pdf(one_minus_cos: float) -> float:
    """Density [1/sr] of `sample_cone`; 0 for a cone without extent, which nothing hits by chance."""
    if one_minus_cos <= 0.0:
        return 0.0
    return 1.0 / (wp.TAU * one_minus_cos)


@wp.func
def sample_triangle(u: wp.vec2) -> wp.vec3:
    """Uniform barycentric coordinates, >= 0, with sum 1, keeping neighbours (Heitz 2019)."""
    a = u[0]
    b = u[1]
    if b > a:
        a = 0.5 * a
        b = b - a
    else:
        b = 0.5 * b
        a = a - b
    return wp.vec3(a, b, wp.max((1.0 - a) - b, 0.0))


@wp.func
def sample_aperture(u: wp.vec2, blade_count: int, rotation: float) -> wp.vec2:
    """A uniform point of the unit disk, or of the regular polygon inscribed in the unit circle.

    `blade_count` < 3 gives the disk. The middle of a polygon's edge lies at angle `rotation` [rad] from +X, as in
    Blender.
    """
    if blade_count < 3:
        return sample_disk(u)
    scaled = u[0] * float(blade_count)
    blade = wp.min(int(scaled), blade_count - 1)  # the product may round up to blade_count
    b = sample_triangle(wp.vec2(scaled - float(blade), u[1]))
    half = wp.PI / float(blade_count)
    x = (b[0] + b[1]) * wp.cos(half)
    y = (b[0] - b[1]) * wp.sin(half)
    turn = rotation + 2.0 * half * float(blade)
    c = wp.cos(turn)
    s = wp.sin(turn)
    return wp.vec2(c * x - s * y, s * x + c * y)


@wp.func
def tangent_of(normal: wp.vec3) -> wp.vec3:
    """A unit vector perpendicular to unit `normal` (Duff et al., "Building an Orthonormal Basis, Revisited", 2017)."""
    sign = wp.where(normal[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + normal[2])
    return wp.vec3(1.0 + sign * normal[0] * normal[0] * a, sign * normal[0] * normal[1] * a, -sign * normal[0])


@wp.func
def bitangent_of(normal: wp.vec3) -> wp.vec3:
    """Unit vector cross(normal, tangent_of(normal)), from the same construction."""
    sign = wp.where(normal[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + normal[2])
    return wp.vec3(normal[0] * normal[1] * a, sign + normal[1] * normal[1] * a, -normal[1])


@wp.func
def to_world(local: wp.vec3, tangent: wp.vec3, bitangent: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """`local` = (along tangent, along bitangent, along normal) in world axes, normalised."""
    return wp.normalize(local[0] * tangent + local[1] * bitangent + local[2] * normal)


@wp.func
def sample_cone_around(axis: wp.vec3, one_minus_cos: float, u: wp.vec2) -> wp.vec3:
    """`sample_cone` about the unit vector `axis`."""
    return to_world(sample_cone(u, one_minus_cos), tangent_of(axis), bitangent_of(axis), axis)


@wp.func
def is_in_cone(direction: wp.vec3, axis: wp.vec3, one_minus_cos: float) -> bool:
    """Whether the unit vector `direction` is one that `sample_cone_around` finds."""
    # the chord keeps its precision where the cosine is almost 1
    chord = direction - axis
    return wp.dot(chord, chord) <= 2.0 * one_minus_cos


@wp.func
def spherical_direction(cos_theta: float, phi: float) -> wp.vec3:
    """Unit direction at polar angle theta from +Z and azimuth `phi` from +X [rad]."""
    r = wp.sqrt(wp.max((1.0 - cos_theta) * (1.0 + cos_theta), 0.0))
    return wp.vec3(r * wp.cos(phi), r * wp.sin(phi), cos_theta)


# --- pixel filter ---------------------------------------------------------------------------------


@functools.cache
def filter_table(name: str, width: float) -> np.ndarray:
    """Inverse CDF of a pixel filter at FILTER_TABLE_SIZE even probabilities from 0 to 1.

    Offsets from the pixel's centre [pixels], float32, shape [FILTER_TABLE_SIZE], increasing and exactly antisymmetric,
    kept for the next render: not to be written to.
    Shapes and extents are those of Blender's Cycles: "BOX" is 1 pixel wide whatever `width`; "GAUSSIAN" is exp(-8 (x /
    width)^2) on |x| < 1.5 width; "BLACKMAN_HARRIS" is the 4-term window on |x| < width. `width` in pixels, > 0; raises
    `ValueError` for an unknown name.
    """
    probability = np.linspace(0.0, 1.0, FILTER_TABLE_SIZE)[FILTER_TABLE_SIZE // 2 :]
    if name == "BOX":
        upper = probability - 0.5
    elif name == "GAUSSIAN":
        erf = np.vectorize(math.erf)
        scale = math.sqrt(8.0) / width  # exp(-(scale x)^2)
        extent = 1.5 * width
        total = 2.0 * math.erf(scale * extent)
        upper = _invert(lambda x: 0.5 + erf(scale * x) / total, probability, extent)
    elif name == "BLACKMAN_HARRIS":
        upper = _invert(lambda x: _blackman_harris_cdf(x / width), probability, width)
    else:
        raise ValueError(f"no pixel filter is called {name!r}; there are BOX, GAUSSIAN, BLACKMAN_HARRIS")
    table = np.concatenate([-upper[::-1], upper]).astype(np.float32)
    table.flags.writeable = False
    return table


def _blackman_harris_cdf(x: np.ndarray) -> np.ndarray:
    """Integral from -1 to x of the window on [-1, 1], normalised (Harris 1978, 92 dB)."""
    angle = np.pi * x  # the cosines of odd multiples change sign with the window centred on 0
    wave = 0.48829 * np.sin(angle) + 0.14128 * np.sin(2 * angle) / 2 + 0.01168 * np.sin(3 * angle) / 3
    return 0.5 + (0.35875 * angle + wave) / (2 * np.pi * 0.35875)


def _invert(cdf, probability: np.ndarray, extent: float) -> np.ndarray:
    """x in [0, extent] with cdf(x) = probability, by bisection to the last bit of float64."""
    low, high = np.zeros_like(probability), np.full_like(probability, extent)
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = cdf(middle) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    high[-1] = extent  # probability 1
    return high


@wp.func
def _filter_offset(table: wp.array(dtype=float), u: float) -> float:
    position = u * float(FILTER_TABLE_SIZE - 1)
    i = wp.min(int(position), FILTER_TABLE_SIZE - 2)
    return wp.lerp(table[i], table[i + 1], position - float(i))


@wp.func
def sample_filter(table: wp.array(dtype=float), u: wp.vec2) -> wp.vec2:
    """Offset from the pixel's centre [pixels], distributed as the separable filter of `filter_table`."""
    return wp.vec2(_filter_offset(table, u[0]), _filter_offset(table, u[1]))
