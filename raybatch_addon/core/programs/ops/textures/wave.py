"""Bands and rings: a wave along an axis or away from one, its phase distorted by fractal noise."""

from enum import IntEnum

import warp as wp

from ....float32 import HALF_PI, TWO_PI
from ...op import NodeData, number, op, put_number, put_vector, vector
from ...point import ShadingPoint
from ..values.finite import finite_or_zero
from .checker import NUDGE, SHRINK
from .noise import FractalKind, fractal_noise_3d, make_fractal


class WaveKind(IntEnum):
    """Shape of a wave's fronts.

    Values below 4: planes across an axis, and across the diagonal; above: cylinders, spheres.
    """

    BANDS_X = 0
    BANDS_Y = 1
    BANDS_Z = 2
    BANDS_DIAGONAL = 3
    RINGS_X = 4
    RINGS_Y = 5
    RINGS_Z = 6
    RINGS_SPHERICAL = 7


class WaveProfile(IntEnum):
    """Profile of a wave, from 0 to 1."""

    SINE = 0
    SAW = 1
    TRIANGLE = 2


_DIAGONAL = wp.constant(int(WaveKind.BANDS_DIAGONAL))
_RINGS_X = wp.constant(int(WaveKind.RINGS_X))
_SPHERICAL = wp.constant(int(WaveKind.RINGS_SPHERICAL))
_SINE = wp.constant(int(WaveProfile.SINE))
_SAW = wp.constant(int(WaveProfile.SAW))
_FBM = wp.constant(int(FractalKind.FBM))


@wp.struct
class Distortion:
    """Distortion of a wave's phase by noise."""

    amount: float  # [radians]; 0: none
    detail: float  # octaves after the first, [0, 15]
    scale: float  # scale of the noise over that of the wave
    roughness: float  # height of an octave over that of the one before


@wp.func
def wave(kind: int, profile: int, p: wp.vec3, phase: float, distortion: Distortion) -> float:
    """The wave's height at `p`, in [0, 1].

    The phase grows by 20 radians a unit across fronts (17.3 on the diagonal); `phase` in radians.
    """
    q = wp.vec3((p[0] + NUDGE) * SHRINK, (p[1] + NUDGE) * SHRINK, (p[2] + NUDGE) * SHRINK)
    if kind < _DIAGONAL:
        angle = q[kind] * 20.0
    elif kind == _DIAGONAL:
        angle = (q[0] + q[1] + q[2]) * 10.0
    else:
        across = q
        if kind < _SPHERICAL:
            across[kind - _RINGS_X] = 0.0
        angle = wp.length(across) * 20.0
    angle += phase
    if distortion.amount != 0.0:
        fractal = make_fractal(_FBM, 1, distortion.detail, distortion.roughness, 2.0, 0.0, 0.0)
        angle += distortion.amount * (fractal_noise_3d(q * distortion.scale, fractal) * 2.0 - 1.0)
    angle = finite_or_zero(angle)
    if profile == _SINE:
        return 0.5 + 0.5 * wp.sin(angle - HALF_PI)
    turns = angle * wp.static(1.0 / TWO_PI)
    if profile == _SAW:
        return turns - wp.floor(turns)
    return wp.abs(turns - wp.floor(turns + 0.5)) * 2.0


@op("wave", "iivnnnnnn>NV", foldable=False)
@wp.func
def wave_op(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """Wave texture, factor and colour.

    Operands: `WaveKind`, `WaveProfile`, vector, scale, phase; amount, detail, scale and roughness of the distortion.
    """
    distortion = Distortion()
    distortion.amount = number(data, stack, pc + 6)
    distortion.detail = number(data, stack, pc + 7)
    distortion.scale = number(data, stack, pc + 8)
    distortion.roughness = number(data, stack, pc + 9)
    p = vector(data, stack, pc + 3) * number(data, stack, pc + 4)
    value = wave(data.code[pc + 1], data.code[pc + 2], p, number(data, stack, pc + 5), distortion)
    put_number(data, stack, pc + 10, value)
    put_vector(data, stack, pc + 11, wp.vec3(value, value, value))
