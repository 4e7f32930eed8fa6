"""Gabor noise: sums of randomly placed wavelets, as value, phase and intensity.

Each unit cell holds eight wavelets of random position and sign. Lagae et al., "Procedural Noise using Sparse Gabor
Convolution" (SIGGRAPH 2009); stratified positions and random signs of Tavernier et al., "Making Gabor Noise Fast and
Normalized" (Eurographics 2019); phase and intensity of Tricard et al., "Procedural Phasor Noise" (SIGGRAPH 2019). Any
input gives a finite result.
"""

import math

import warp as wp

from ....float32 import PI, TWO_PI
from ...op import NodeData, number, op, put_number, vector
from ...point import ShadingPoint
from ..values.finite import finite_or_zero
from .hashing import hash_3_to_1, hash_3_to_2, hash_4_to_1, hash_4_to_2, hash_4_to_3

_WAVELETS = 8  # wavelets of a cell
_FREQUENCY_MIN = 1e-3
# A wavelet's squared integral (limit of high frequencies) is 1/4 in the plane and 1 / (4 sqrt 2) in space; a random
# sign's second moment is taken as 1/2. [0, 1] holds six deviations of the sum.
_DEVIATIONS_2D = wp.constant(6.0 * math.sqrt(_WAVELETS * 0.5 * 0.25))
_DEVIATIONS_3D = wp.constant(6.0 * math.sqrt(_WAVELETS * 0.5 * 0.25 / math.sqrt(2.0)))


@wp.func
def _wavelet(squared_distance: float, turns: float) -> wp.vec2:
    """A phasor under a Gaussian that a Hann window ends at distance 1; `turns` is the phase in full turns."""
    window = 0.5 + 0.5 * wp.cos(PI * squared_distance)
    amplitude = wp.exp(-PI * squared_distance) * window
    angle = TWO_PI * turns
    return wp.vec2(amplitude * wp.cos(angle), amplitude * wp.sin(angle))


@wp.func
def _sign(hashed: float) -> float:
    return wp.where(hashed < 0.5, -1.0, 1.0)


@wp.func
def gabor_phasor_2d(position: wp.vec2, frequency: float, isotropy: float, orientation: float) -> wp.vec2:
    """The sum of wavelets around `position`, a phasor.

    `orientation` [rad]; `isotropy` in [0, 1] turns each wavelet at random by up to 90 degrees.
    """
    x = finite_or_zero(position[0])
    y = finite_or_zero(position[1])
    cell = wp.vec2(wp.floor(x), wp.floor(y))
    local = wp.vec2(x, y) - cell
    result = wp.vec2()
    count = int(9)  # `count` is a variable, so that the loops are not unrolled
    wavelets = int(wp.static(_WAVELETS))
    for n in range(count):
        offset = wp.vec2(float(n % 3 - 1), float(n // 3 - 1))
        in_cell = local - offset
        cx = cell[0] + offset[0]
        cy = cell[1] + offset[1]
        for i in range(wavelets):
            seed = float(3 * i)
            from_centre = in_cell - hash_3_to_2(cx, cy, seed + 1.0)
            squared = wp.dot(from_centre, from_centre)
            if squared < 1.0:
                turned = orientation + (hash_3_to_1(cx, cy, seed) - 0.5) * PI * isotropy
                wave = wp.vec2(frequency * wp.cos(turned), frequency * wp.sin(turned))
                result = result + _sign(hash_3_to_1(cx, cy, seed + 2.0)) * _wavelet(squared, wp.dot(from_centre, wave))
    return result


@wp.func
def gabor_phasor_3d(position: wp.vec3, frequency: float, isotropy: float, orientation: wp.vec3) -> wp.vec2:
    """The sum of wavelets around `position`, a phasor.

    `orientation` is a unit vector, or 0; `isotropy` in [0, 1] turns it by up to 180 degrees.
    """
    x = finite_or_zero(position[0])
    y = finite_or_zero(position[1])
    z = finite_or_zero(position[2])
    cell = wp.vec3(wp.floor(x), wp.floor(y), wp.floor(z))
    local = wp.vec3(x, y, z) - cell
    # Spherical angles of the orientation
    inclination = wp.acos(wp.clamp(orientation[2], -1.0, 1.0))
    flat = wp.sqrt(orientation[0] * orientation[0] + orientation[1] * orientation[1])
    azimuth = float(0.0)
    if flat > 0.0:
        azimuth = wp.where(orientation[1] < 0.0, -1.0, 1.0) * wp.acos(wp.clamp(orientation[0] / flat, -1.0, 1.0))
    result = wp.vec2()
    count = int(27)
    wavelets = int(wp.static(_WAVELETS))
    for n in range(count):
        offset = wp.vec3(float(n % 3 - 1), float((n // 3) % 3 - 1), float(n // 9 - 1))
        in_cell = local - offset
        c = cell + offset
        for i in range(wavelets):
            seed = float(3 * i)
            from_centre = in_cell - hash_4_to_3(c[0], c[1], c[2], seed + 1.0)
            squared = wp.dot(from_centre, from_centre)
            if squared < 1.0:
                wave = orientation
                if isotropy > 0.0:
                    turn = hash_4_to_2(c[0], c[1], c[2], seed) * (PI * isotropy)
                    theta = inclination + turn[0]
                    phi = azimuth + turn[1]
                    wave = wp.vec3(wp.sin(theta) * wp.cos(phi), wp.sin(theta) * wp.sin(phi), wp.cos(theta))
                sign = _sign(hash_4_to_1(c[0], c[1], c[2], seed + 2.0))
                result = result + sign * _wavelet(squared, wp.dot(from_centre, frequency * wave))
    return result


@wp.func
def gabor_outputs(phasor: wp.vec2, deviations: float) -> wp.vec3:
    """Value, phase and intensity of a sum of wavelets, the first two in [0, 1]."""
    value = 0.5 * (phasor[1] / deviations) + 0.5
    phase = (wp.atan2(phasor[1], phasor[0]) + PI) / TWO_PI
    intensity = wp.length(phasor) / deviations
    return wp.vec3(finite_or_zero(value), finite_or_zero(phase), finite_or_zero(intensity))


@wp.func
def gabor_2d(coordinates: wp.vec3, scale: float, frequency: float, anisotropy: float, orientation: float) -> wp.vec3:
    """Value, phase and intensity of Gabor noise in the plane; `orientation` [rad]."""
    isotropy = 1.0 - wp.clamp(finite_or_zero(anisotropy), 0.0, 1.0)
    position = wp.vec2(coordinates[0] * scale, coordinates[1] * scale)
    phasor = gabor_phasor_2d(
        position, wp.max(wp.static(_FREQUENCY_MIN), finite_or_zero(frequency)), isotropy, finite_or_zero(orientation)
    )
    return gabor_outputs(phasor, _DEVIATIONS_2D)


@wp.func
def gabor_3d(coordinates: wp.vec3, scale: float, frequency: float, anisotropy: float, orientation: wp.vec3) -> wp.vec3:
    """Value, phase and intensity of Gabor noise in space; `orientation` need not be normalized.

    All are 0 where the orientation has no direction. They are 0 too where it points along z and wavelets turn:
    Blender's azimuth of such an orientation is not a number.
    """
    isotropy = 1.0 - wp.clamp(finite_or_zero(anisotropy), 0.0, 1.0)
    finite = wp.vec3(finite_or_zero(orientation[0]), finite_or_zero(orientation[1]), finite_or_zero(orientation[2]))
    unit = wp.normalize(finite)
    if wp.dot(unit, unit) == 0.0 or (isotropy > 0.0 and unit[0] == 0.0 and unit[1] == 0.0):
        return wp.vec3()
    phasor = gabor_phasor_3d(
        coordinates * scale, wp.max(wp.static(_FREQUENCY_MIN), finite_or_zero(frequency)), isotropy, unit
    )
    return gabor_outputs(phasor, _DEVIATIONS_3D)


@op("gabor_2d", "vnnnn>NNN", foldable=False)
@wp.func
def _gabor_2d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    result = gabor_2d(
        vector(data, stack, pc + 1),
        number(data, stack, pc + 2),
        number(data, stack, pc + 3),
        number(data, stack, pc + 4),
        number(data, stack, pc + 5),
    )
    put_number(data, stack, pc + 6, result[0])
    put_number(data, stack, pc + 7, result[1])
    put_number(data, stack, pc + 8, result[2])


@op("gabor_3d", "vnnnv>NNN", foldable=False)
@wp.func
def _gabor_3d(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    result = gabor_3d(
        vector(data, stack, pc + 1),
        number(data, stack, pc + 2),
        number(data, stack, pc + 3),
        number(data, stack, pc + 4),
        vector(data, stack, pc + 5),
    )
    put_number(data, stack, pc + 6, result[0])
    put_number(data, stack, pc + 7, result[1])
    put_number(data, stack, pc + 8, result[2])
