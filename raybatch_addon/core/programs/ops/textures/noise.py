"""Fractal noise: octaves of gradient noise, combined in five ways, distorted, one sum for each channel of a colour.

After F. K. Musgrave's chapters of Ebert et al., "Texturing and Modeling" (2003), with Blender's choice of parameters.
Beyond the whole part of `detail` one more octave comes in by the fraction. Results are finite for any input; only
normalised FBM is about in [0, 1].
"""

from enum import IntEnum
from types import SimpleNamespace

import warp as wp

from ...op import NodeData, number, op, put_number, put_vector, vector, wanted
from ...point import ShadingPoint
from ..values.finite import finite_or_zero
from .hashing import hash_1_to_1, hash_2_to_1
from .perlin import signed_noise_1d, signed_noise_2d, signed_noise_3d, signed_noise_4d, sum_with_product


class FractalKind(IntEnum):
    """How octaves are combined."""

    MULTIFRACTAL = 0
    FBM = 1
    HYBRID_MULTIFRACTAL = 2
    RIDGED_MULTIFRACTAL = 3
    HETERO_TERRAIN = 4


DETAIL_MAX = 15.0  # most octaves after the first

_MULTIFRACTAL = wp.constant(int(FractalKind.MULTIFRACTAL))
_FBM = wp.constant(int(FractalKind.FBM))
_HYBRID = wp.constant(int(FractalKind.HYBRID_MULTIFRACTAL))
_RIDGED = wp.constant(int(FractalKind.RIDGED_MULTIFRACTAL))
_TERRAIN = wp.constant(int(FractalKind.HETERO_TERRAIN))
_DETAIL_MAX = wp.constant(DETAIL_MAX)
_HYBRID_WEIGHT_LEAST = wp.constant(0.001)  # least weight of an octave of the hybrid that counts


@wp.struct
class Fractal:
    """Parameters of fractal noise, finite."""

    kind: int  # `FractalKind`
    normalize: int  # 1: FBM in [0, 1]
    detail: float  # octaves after the first, [0, `DETAIL_MAX`]
    roughness: float  # height of an octave over that of the one before, at least 0
    lacunarity: float  # frequency of an octave over that of the one before
    offset: float  # added to each octave's noise (HYBRID, RIDGED, TERRAIN)
    gain: float  # factor of an octave's height in the weight of the next (HYBRID, RIDGED)


@wp.func
def make_fractal(
    kind: int, normalize: int, detail: float, roughness: float, lacunarity: float, offset: float, gain: float
) -> Fractal:
    """A `Fractal` with detail and roughness within their ranges; numbers that are not finite become 0."""
    fractal = Fractal()
    fractal.kind = kind
    fractal.normalize = normalize
    fractal.detail = wp.clamp(finite_or_zero(detail), 0.0, _DETAIL_MAX)
    fractal.roughness = wp.max(finite_or_zero(roughness), 0.0)
    fractal.lacunarity = finite_or_zero(lacunarity)
    fractal.offset = finite_or_zero(offset)
    fractal.gain = finite_or_zero(gain)
    return fractal


@wp.func
def _half_up(value: float, heights: float) -> float:
    return 0.5 * value / heights + 0.5


@wp.func
def _offset_of(seed: int, axis: int) -> float:
    """A coordinate in [100, 200], another for each seed: noise shifted by it is independent of the noise here."""
    return sum_with_product(100.0, hash_2_to_1(float(seed), float(axis)), 100.0)


@wp.func
def _offset_1d(seed: int) -> float:
    return sum_with_product(100.0, hash_1_to_1(float(seed)), 100.0)


@wp.func
def _offset_2d(seed: int) -> wp.vec2:
    return wp.vec2(_offset_of(seed, 0), _offset_of(seed, 1))


@wp.func
def _offset_3d(seed: int) -> wp.vec3:
    return wp.vec3(_offset_of(seed, 0), _offset_of(seed, 1), _offset_of(seed, 2))


@wp.func
def _offset_4d(seed: int) -> wp.vec4:
    return wp.vec4(_offset_of(seed, 0), _offset_of(seed, 1), _offset_of(seed, 2), _offset_of(seed, 3))


_POINTS = (float, wp.vec2, wp.vec3, wp.vec4)
_SIGNED_NOISE = (signed_noise_1d, signed_noise_2d, signed_noise_3d, signed_noise_4d)
_OFFSETS = (_offset_1d, _offset_2d, _offset_3d, _offset_4d)


def make_fractal_noise(dimensions: int) -> SimpleNamespace:
    """Functions of noise in 1 to 4 dimensions, whose points are floats or vectors.

    `sum` (point, Fractal) -> float: the sum of octaves. `texture` (point, Fractal, distortion, channels: 1 or 3) ->
    vec3: the sums of as many channels, each shifted, after noise has moved the point. Loops have counts that the
    compiler does not know: each noise is compiled once.
    """
    Point = _POINTS[dimensions - 1]
    signed_noise = _SIGNED_NOISE[dimensions - 1]
    offset_of = _OFFSETS[dimensions - 1]

    @wp.func
    def sum_of_octaves(p: Point, fractal: Fractal) -> float:
        kind = fractal.kind
        rest = fractal.detail - wp.floor(fractal.detail)
        whole = int(fractal.detail) + 1
        octaves = whole
        if rest != 0.0 and kind != _RIDGED:
            octaves = whole + 1
        value = float(wp.where(kind == _MULTIFRACTAL, 1.0, 0.0))
        height = float(1.0)
        weight = float(1.0)  # weight of the next octave, which this one reduces (HYBRID, RIDGED)
        scale = float(1.0)
        heights = float(0.0)
        value_before = float(0.0)  # value and heights without the last octave (FBM)
        heights_before = float(0.0)
        q = p
        for octave in range(octaves):
            noise = signed_noise(q)
            part = float(wp.where(octave == whole, rest, 1.0))
            if kind == _FBM:
                value_before = value
                heights_before = heights
                value = sum_with_product(value, noise, height)
                heights += height
                scale *= fractal.lacunarity
                q = scale * p
            else:
                if kind == _MULTIFRACTAL:
                    value *= sum_with_product(1.0, part * height, noise)
                elif kind == _TERRAIN:
                    value = sum_with_product(
                        value, part, (noise + fractal.offset) * height * wp.where(octave == 0, 1.0, value)
                    )
                elif kind == _HYBRID:
                    if not (weight > _HYBRID_WEIGHT_LEAST):
                        break
                    weight = wp.min(weight, 1.0)
                    signal = (noise + fractal.offset) * height
                    value = sum_with_product(value, part * weight, signal)
                    weight *= fractal.gain * signal
                else:
                    ridge = fractal.offset - wp.abs(noise)
                    signal = ridge * ridge * weight
                    value = sum_with_product(value, signal, height)
                    weight = wp.clamp(signal * fractal.gain, 0.0, 1.0)
                q = q * fractal.lacunarity
            height *= fractal.roughness
        if kind == _FBM:
            if fractal.normalize != 0:
                value = _half_up(value, heights)
                value_before = _half_up(value_before, heights_before)
            if rest != 0.0:
                value = sum_with_product(value_before, rest, value - value_before)
        return finite_or_zero(value)

    if dimensions == 1:

        @wp.func
        def distorted(p: float, distortion: float) -> float:
            return p + signed_noise(p + offset_of(0)) * distortion

    else:

        @wp.func
        def distorted(p: Point, distortion: float) -> Point:
            moved = p
            axes = int(dimensions)
            for axis in range(axes):
                moved[axis] += signed_noise(p + offset_of(axis)) * distortion
            return moved

    @wp.func
    def texture(p: Point, fractal: Fractal, distortion: float, channels: int) -> wp.vec3:
        q = p
        if distortion != 0.0:
            q = distorted(p, distortion)
        values = wp.vec3()
        for channel in range(channels):
            r = q
            if channel > 0:
                r = q + offset_of(wp.static(dimensions - 1) + channel)
            values[channel] = sum_of_octaves(r, fractal)
        return values

    return SimpleNamespace(sum=sum_of_octaves, texture=texture)


_1D, _2D, _3D, _4D = (make_fractal_noise(dimensions) for dimensions in (1, 2, 3, 4))
noise_texture_1d, noise_texture_2d, noise_texture_3d, noise_texture_4d = (
    _1D.texture,
    _2D.texture,
    _3D.texture,
    _4D.texture,
)
fractal_noise_3d = _3D.sum


@wp.func
def _fractal_at(data: NodeData, stack: wp.array(dtype=float), pc: int, at: int) -> Fractal:
    """The `Fractal` of an instruction whose word for detail is at `at`."""
    return make_fractal(
        data.code[pc + 1],
        data.code[pc + 2],
        number(data, stack, at),
        number(data, stack, at + 1),
        number(data, stack, at + 2),
        number(data, stack, at + 3),
        number(data, stack, at + 4),
    )


@wp.func
def _put(data: NodeData, stack: wp.array(dtype=float), at: int, values: wp.vec3):
    put_number(data, stack, at, values[0])
    put_vector(data, stack, at + 1, values)


# Each takes a kind (`FractalKind`), normalize, the point, scale, detail, roughness, lacunarity, offset, gain and
# distortion


@op("noise_1d", "iinnnnnnnn>NV", foldable=False)
@wp.func
def noise_1d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Factor and colour of fractal noise at a number."""
    p = number(data, stack, pc + 3) * number(data, stack, pc + 4)
    channels = wp.where(wanted(data, pc + 12), 3, 1)
    _put(
        data,
        stack,
        pc + 11,
        noise_texture_1d(p, _fractal_at(data, stack, pc, pc + 5), number(data, stack, pc + 10), channels),
    )


@op("noise_2d", "iivnnnnnnn>NV", foldable=False)
@wp.func
def noise_2d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Factor and colour of fractal noise at a vector's x and y."""
    p = vector(data, stack, pc + 3) * number(data, stack, pc + 4)
    channels = wp.where(wanted(data, pc + 12), 3, 1)
    fractal = _fractal_at(data, stack, pc, pc + 5)
    _put(data, stack, pc + 11, noise_texture_2d(wp.vec2(p[0], p[1]), fractal, number(data, stack, pc + 10), channels))


@op("noise_3d", "iivnnnnnnn>NV", foldable=False)
@wp.func
def noise_3d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Factor and colour of fractal noise at a vector."""
    p = vector(data, stack, pc + 3) * number(data, stack, pc + 4)
    channels = wp.where(wanted(data, pc + 12), 3, 1)
    _put(
        data,
        stack,
        pc + 11,
        noise_texture_3d(p, _fractal_at(data, stack, pc, pc + 5), number(data, stack, pc + 10), channels),
    )


@op("noise_4d", "iivnnnnnnnn>NV", foldable=False)
@wp.func
def noise_4d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Factor and colour of fractal noise at a vector and a number."""
    scale = number(data, stack, pc + 5)
    p = vector(data, stack, pc + 3) * scale
    w = number(data, stack, pc + 4) * scale
    channels = wp.where(wanted(data, pc + 13), 3, 1)
    fractal = _fractal_at(data, stack, pc, pc + 6)
    _put(
        data,
        stack,
        pc + 12,
        noise_texture_4d(wp.vec4(p[0], p[1], p[2], w), fractal, number(data, stack, pc + 11), channels),
    )
