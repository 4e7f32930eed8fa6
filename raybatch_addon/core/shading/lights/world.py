"""Sampling of a world whose radiance varies: a table of directions, each as likely as it is bright, or brighter than
the mean.

The sphere of directions is cut into texels, equal steps of the angles around and away from +Z. A texel is chosen with a
probability in proportion to its light (Pharr, Jakob and Humphreys 2023, section 12.5.2), and a direction within it
uniformly by solid angle, so that the density is exact whatever the radiance within a texel.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...float32 import ONE_BELOW
from ...scene.description import SkySun
from ..sampling import is_in_cone, sample_cone_around
from .world_sun import SunCone, solid_angle, sun_cone, sun_cone_pdf, without_sun

# Least light that a texel counts for, as a share of the mean: light that the texels' test points missed is still found
_FLOOR = 1e-3
# ... and as a share of the brightest texel around it: the rim of a sun may lie between the points of a texel
_AROUND = 0.05
# Spherical harmonics up to the second band: squares of their constants times the cosine's factors pi, 2 pi / 3, pi / 4
_COSINE_SCALE = np.array([1 / 4, 1 / 2, 1 / 2, 1 / 2, 15 / 16, 15 / 16, 15 / 192, 15 / 16, 15 / 64])
# Variance of a world, beside the square of its mean, up to which it is left to scattered rays
_EVEN = 1e-3


@wp.struct
class WorldTable:
    """Probabilities in units of 2^-32; no entries: the world is not sampled."""

    width: int  # texels around
    height: int  # texels from +Z to -Z
    # begin of each row's interval of [0, 2^32), then of each texel's within its row; [height + height * width]
    first: wp.array(dtype=wp.uint32)
    sun: SunCone  # of whose light the texels know nothing


@wp.struct
class WorldDirection:
    """A direction into the world."""

    direction: wp.vec3  # unit
    pdf: float  # [1/sr]


@dataclass(frozen=True)
class SampledWorld:
    """A world that is sampled."""

    table: WorldTable
    # irradiance, by what is sampled, of a surface with the normal n: coefficients of 1, y, z, x, xy, yz, 3 z² - 1, xz,
    # x² - y²
    irradiance: np.ndarray  # float64, shape [9]


@dataclass(frozen=True)
class WorldLight:
    """How bright a world is."""

    texels: np.ndarray  # that of `build_world_table`
    sun: SkySun | None = None
    within_sun: float = 0.0  # mean brightness in the directions to the sun, >= 0 and finite

    @property
    def has_sun(self) -> bool:
        """Whether there is a sun that shines."""
        return self.sun is not None and self.within_sun > 0


def sampled_world(light: WorldLight, device: wp.Device, even: bool = False, beside_rays: bool = False) -> SampledWorld:
    """The world that is as bright as `light`. `even`: its table has one texel.

    `beside_rays`: rays that surfaces scatter find the world too, and both ways are weighed against each other. Then
    only what is brighter than the mean is aimed at, and the world competes with other emitters by that alone: the rest
    is found as well by the rays (Karlik, Sik, Vevoda, Skrivan and Krivanek 2019, "MIS Compensation: Optimizing Sampling
    Techniques in Multiple Importance Sampling", section 4).
    """
    texels, of_sun, irradiance = light.texels, 0.0, np.zeros(9)
    if light.has_sun:
        texels = without_sun(texels, light.sun)
        of_sun = light.within_sun * solid_angle(light.sun)
        irradiance = of_sun * _irradiance_of_one(*light.sun.direction)
    if beside_rays:
        mean = _mean(texels) + of_sun / (4 * np.pi)
        texels = np.maximum(texels - np.float32(mean), 0)
    irradiance += _irradiance(texels)
    table = build_world_table(np.ones((1, 1), np.float32) if even else texels, device)
    if light.has_sun:
        table.sun = sun_cone(light.sun, of_sun / (of_sun + 4 * np.pi * _mean(texels)))
    return SampledWorld(table, irradiance)


def is_even(light: WorldLight) -> bool:
    """Whether a world's light hardly differs by direction, so that rays which surfaces scatter find it better by
    themselves: by the variance of its texels over the sphere beside the square of the mean. No world with a sun is.
    """
    return not light.has_sun and _is_even(light.texels)


def _is_even(light: np.ndarray) -> bool:
    largest = max(float(light.max()), 1e-30)  # squares of what is scaled by it are in range
    mean = _mean(light) / largest
    squares = [float(np.square(row.astype(np.float64) / largest - mean).sum()) for row in light]
    return bool(_texel_shares(light) @ np.array(squares) <= _EVEN * mean**2)


def _texel_shares(light: np.ndarray) -> np.ndarray:
    """Share of the sphere that a texel of each row covers, float64, shape [height]."""
    height, width = light.shape
    edges = np.cos(np.arange(height + 1) * (np.pi / height))
    return (edges[:-1] - edges[1:]) / (2 * width)


def _mean(light: np.ndarray) -> float:
    """Mean over the sphere."""
    return float((_texel_shares(light) * light.sum(1, dtype=np.float64)).sum())


def _irradiance(light: np.ndarray) -> np.ndarray:
    """`SampledWorld.irradiance` of texels: spherical harmonics up to the second band, convolved with the cosine
    (Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", equations 3 and 13).
    """
    height, width = light.shape
    edges = np.cos(np.arange(height + 1) * (np.pi / height))
    z = (edges[:-1] + edges[1:])[:, None] / 2
    sine = np.sqrt(1 - z * z)
    around = (np.arange(width) + 0.5) * (2 * np.pi / width)
    # sums over each row of what depends on the angle around alone
    waves = [np.ones(width), np.sin(around), np.cos(around), np.sin(2 * around), np.cos(2 * around)]
    one, sin_1, cos_1, sin_2, cos_2 = (light @ wave.astype(np.float64) for wave in waves)
    row = (edges[:-1] - edges[1:]) * (2 * np.pi / width)
    z, sine = z[:, 0], sine[:, 0]
    moments = [
        one,
        sine * sin_1,
        z * one,
        sine * cos_1,
        sine * sine * sin_2 / 2,
        sine * z * sin_1,
        (3 * z * z - 1) * one,
        sine * z * cos_1,
        sine * sine * cos_2,
    ]
    return np.array([(row * each).sum() for each in moments]) * _COSINE_SCALE


def _irradiance_of_one(x: float, y: float, z: float) -> np.ndarray:
    """`SampledWorld.irradiance` of light that comes from one unit direction alone, for an irradiance of 1 there."""
    return np.array([1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y]) * _COSINE_SCALE


def fixed_point_cdf(power: np.ndarray) -> np.ndarray:
    """Selection probabilities in proportion to `power`, in units of 2^-32.

    Args:
        power: float64, shape [n], finite, >= 0; when all are 0, all are as likely.

    Returns:
        Where each one's interval of [0, 2^32) begins, uint32, shape [n], strictly ascending from 0. The last one ends
        at 2^32, so the probabilities sum to exactly 1, and none is below 2^-32: nothing is left out.
    """
    count = len(power)
    if count == 0:
        return np.zeros(0, np.uint32)
    # scaled to at most 1, so that sums stay in range whatever the unit
    largest = power.max()
    share = power / largest if largest > 0 else np.ones(count)
    ends = np.cumsum(share)
    first = np.zeros(count, np.uint64)
    # one unit to each, the rest in proportion
    first[1:] = np.floor(ends[:-1] / ends[-1] * (2.0**32 - count)).astype(np.uint64)
    return (first + np.arange(count, dtype=np.uint64)).astype(np.uint32)


def build_world_table(light: np.ndarray, device: wp.Device) -> WorldTable:
    """The table for the `light` of texels, >= 0 and finite, float32, shape [height, width]; row 0 is around +Z."""
    height, width = light.shape
    edges = np.arange(height + 1) * (np.pi / height)
    share = light.astype(np.float64)
    share += _AROUND * _brightest_around(light) + _FLOOR * share.mean()
    rows = share.sum(1) * (np.cos(edges[:-1]) - np.cos(edges[1:]))
    table = WorldTable()
    table.width, table.height = width, height
    first = np.empty(height + height * width, np.uint32)
    first[:height] = fixed_point_cdf(rows)
    for row, texels in enumerate(first[height:].reshape(height, width)):
        texels[:] = fixed_point_cdf(share[row])
    table.first = wp.array(first, dtype=wp.uint32, device=device)
    return table


def _brightest_around(light: np.ndarray) -> np.ndarray:
    """The largest light of each texel and the eight around it."""
    rows = np.maximum(light, np.maximum(np.roll(light, 1, 1), np.roll(light, -1, 1)))
    result = rows.copy()
    np.maximum(result[1:], rows[:-1], out=result[1:])
    np.maximum(result[:-1], rows[1:], out=result[:-1])
    return result


@wp.func
def _find(first: wp.array(dtype=wp.uint32), begin: int, count: int, bits: wp.uint32) -> int:
    """Index of the last of `count` entries from `begin` on that is not above `bits`, relative to `begin`."""
    low = int(0)
    high = count - 1
    while low < high:
        middle = low + (high - low + 1) // 2
        if first[begin + middle] <= bits:
            low = middle
        else:
            high = middle - 1
    return low


@wp.func
def _probability(first: wp.array(dtype=wp.uint32), begin: int, count: int, index: int) -> float:
    if count == 1:
        return 1.0
    end = wp.uint32(0)  # 2^32 in 32 bits
    if index + 1 < count:
        end = first[begin + index + 1]
    return float(end - first[begin + index]) * wp.static(2.0**-32)


@wp.func
def _within(first: wp.array(dtype=wp.uint32), begin: int, index: int, bits: wp.uint32, probability: float) -> float:
    """Position of `bits` within its interval, 0..1."""
    return wp.min(float(bits - first[begin + index]) / (probability * wp.static(2.0**32)), ONE_BELOW)


@wp.func
def _texel_solid_angle(table: WorldTable, row: int) -> float:
    """Solid angle of a texel [sr]; a product, which does not cancel at the poles."""
    step = wp.PI / float(table.height)
    return wp.TAU / float(table.width) * 2.0 * wp.sin((float(row) + 0.5) * step) * wp.sin(0.5 * step)


@wp.func
def texel_direction(table: WorldTable, row: int, column: int, u: wp.vec2) -> wp.vec3:
    """The direction at the point `u` of a texel, uniform by solid angle."""
    # angles are measured from the nearer pole, where sin²(angle / 2) keeps its digits
    near = row
    if 2 * row >= table.height:
        near = table.height - 1 - row
    half_step = 0.5 * wp.PI / float(table.height)
    a = wp.sin(float(near) * half_step)
    b = wp.sin(float(near + 1) * half_step)
    s = a * a + u[1] * (b * b - a * a)
    sine = 2.0 * wp.sqrt(s * wp.max(1.0 - s, 0.0))
    z = 1.0 - 2.0 * s
    if near != row:
        z = -z
    around = wp.TAU * ((float(column) + u[0]) / float(table.width))
    return wp.vec3(wp.cos(around) * sine, wp.sin(around) * sine, z)


@wp.func
def _sample_texels(table: WorldTable, u: wp.vec2) -> WorldDirection:
    bits_row = wp.uint32(u[0] * wp.static(2.0**24)) << wp.uint32(8)
    bits_column = wp.uint32(u[1] * wp.static(2.0**24)) << wp.uint32(8)
    row = _find(table.first, 0, table.height, bits_row)
    of_row = _probability(table.first, 0, table.height, row)
    begin = table.height + row * table.width
    column = _find(table.first, begin, table.width, bits_column)
    of_column = _probability(table.first, begin, table.width, column)
    within_texel = wp.vec2(
        _within(table.first, begin, column, bits_column, of_column), _within(table.first, 0, row, bits_row, of_row)
    )
    result = WorldDirection()
    result.direction = texel_direction(table, row, column, within_texel)
    result.pdf = of_row * of_column / _texel_solid_angle(table, row)
    return result


@wp.func
def _texels_pdf(table: WorldTable, direction: wp.vec3) -> float:
    """Density with which `_sample_texels` chooses `direction` [1/sr]."""
    sine = wp.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    down = wp.atan2(sine, direction[2]) / wp.PI
    around = wp.atan2(direction[1], direction[0]) / wp.TAU
    if around < 0.0:
        around += 1.0
    row = wp.clamp(int(down * float(table.height)), 0, table.height - 1)
    column = wp.clamp(int(around * float(table.width)), 0, table.width - 1)
    begin = table.height + row * table.width
    chance = _probability(table.first, 0, table.height, row) * _probability(table.first, begin, table.width, column)
    return chance / _texel_solid_angle(table, row)


@wp.func
def sample_world(table: WorldTable, u: wp.vec2) -> WorldDirection:
    """A direction, as likely as the world is bright there."""
    share = table.sun.share
    result = WorldDirection()
    if u[0] < share:
        result.direction = sample_cone_around(
            table.sun.direction, table.sun.one_minus_cos, wp.vec2(wp.min(u[0] / share, ONE_BELOW), u[1])
        )
        # within the cone, wherever rounding took it
        result.pdf = sun_cone_pdf(table.sun) + (1.0 - share) * _texels_pdf(table, result.direction)
    else:
        result = _sample_texels(table, wp.vec2(wp.min((u[0] - share) / (1.0 - share), ONE_BELOW), u[1]))
        if share > 0.0:
            result.pdf = (1.0 - share) * result.pdf
            if is_in_cone(result.direction, table.sun.direction, table.sun.one_minus_cos):
                result.pdf += sun_cone_pdf(table.sun)
    return result


@wp.func
def world_pdf(table: WorldTable, direction: wp.vec3) -> float:
    """Density with which `sample_world` chooses `direction` [1/sr]."""
    pdf = (1.0 - table.sun.share) * _texels_pdf(table, direction)
    if table.sun.share > 0.0:
        if is_in_cone(direction, table.sun.direction, table.sun.one_minus_cos):
            pdf += sun_cone_pdf(table.sun)
    return pdf
