"""Directions of panoramic cameras: where a point of the picture looks, and where a direction is seen.

The projections are those of Cycles (its manual, "Camera: Panoramic"). A camera looks along its -Z, with +X right and +Y
up. A point of the picture is (x, y) in [0, 1]^2 from its lower left corner.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from ..scene.description import CameraKind, Panorama


def panorama_numbers(kind: CameraKind, panorama: Panorama) -> tuple[float, ...]:
    """The eight numbers that `panorama_direction` of this kind reads."""
    width, height = panorama.sensor
    numbers: tuple[float, ...] = ()
    if kind == CameraKind.EQUIRECTANGULAR:
        numbers = _range(panorama.longitude) + _range(panorama.latitude)
    elif kind == CameraKind.CENTRAL_CYLINDRICAL:
        numbers = _range(panorama.cylinder_angles) + _range(panorama.cylinder_heights)
    elif kind == CameraKind.FISHEYE_EQUIDISTANT:
        numbers = (panorama.fov / 2,)
    elif kind == CameraKind.FISHEYE_EQUISOLID:
        twice = 2 * panorama.focal_length
        numbers = (width / twice, height / twice, math.sin(panorama.fov / 4))
    elif kind == CameraKind.FISHEYE_POLYNOMIAL:
        numbers = (width, height, panorama.fov / 2, *panorama.polynomial)
    return numbers + (0.0,) * (8 - len(numbers))


def _range(ends: tuple[float, float]) -> tuple[float, float]:
    """The first end, and the way to the last."""
    return ends[0], ends[1] - ends[0]


@wp.func
def _around(theta: float, x: float, y: float) -> wp.vec3:
    """The direction at the angle `theta` [rad] from the view axis, towards (x, y) of the picture."""
    r = wp.sqrt(x * x + y * y)
    if r == 0.0:
        return wp.vec3(wp.sin(theta), 0.0, -wp.cos(theta))
    s = wp.sin(theta)
    return wp.vec3(s * (x / r), s * (y / r), -wp.cos(theta))


@wp.func
def _equirectangular(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    longitude = numbers[0] + x * numbers[1]
    latitude = numbers[2] + y * numbers[3]
    level = wp.cos(latitude)
    return wp.vec3(level * wp.sin(longitude), wp.sin(latitude), -level * wp.cos(longitude))


@wp.func
def _equiangular_cubemap_face(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    u = wp.tan((x - 0.5) * wp.static(math.pi / 2))
    v = wp.tan((y - 0.5) * wp.static(math.pi / 2))
    return wp.normalize(wp.vec3(u, v, -1.0))


@wp.func
def _mirror_ball(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    # what is seen in a ball of mirror that is far ahead: the normal there, and the reflected view axis
    u = 2.0 * x - 1.0
    v = 2.0 * y - 1.0
    square = u * u + v * v
    if square > 1.0:
        return wp.vec3(0.0, 0.0, 0.0)
    ahead = wp.sqrt(1.0 - square)
    return wp.vec3(2.0 * ahead * u, 2.0 * ahead * v, 1.0 - 2.0 * ahead * ahead)


@wp.func
def _fisheye_equidistant(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    u = 2.0 * x - 1.0
    v = 2.0 * y - 1.0
    r = wp.sqrt(u * u + v * v)
    if r > 1.0:
        return wp.vec3(0.0, 0.0, 0.0)
    return _around(r * numbers[0], u, v)


@wp.func
def _fisheye_equisolid(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    u = (x - 0.5) * numbers[0]
    v = (y - 0.5) * numbers[1]
    r = wp.sqrt(u * u + v * v)  # the sine of half the angle
    if r > numbers[2] or r > 1.0:
        return wp.vec3(0.0, 0.0, 0.0)
    return _around(2.0 * wp.asin(r), u, v)


@wp.func
def _fisheye_polynomial(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    u = (x - 0.5) * numbers[0]
    v = (y - 0.5) * numbers[1]
    r = wp.sqrt(u * u + v * v)
    theta = -(numbers[3] + r * (more[0] + r * (more[1] + r * (more[2] + r * more[3]))))
    if not (wp.abs(theta) <= numbers[2]):
        return wp.vec3(0.0, 0.0, 0.0)
    return _around(theta, u, v)


@wp.func
def _central_cylindrical(numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    angle = numbers[0] + x * numbers[1]
    height = numbers[2] + y * numbers[3]
    return wp.normalize(wp.vec3(wp.sin(angle), height, -wp.cos(angle)))


_DIRECTIONS = {
    CameraKind.EQUIRECTANGULAR: _equirectangular,
    CameraKind.EQUIANGULAR_CUBEMAP_FACE: _equiangular_cubemap_face,
    CameraKind.MIRROR_BALL: _mirror_ball,
    CameraKind.FISHEYE_EQUIDISTANT: _fisheye_equidistant,
    CameraKind.FISHEYE_EQUISOLID: _fisheye_equisolid,
    CameraKind.FISHEYE_POLYNOMIAL: _fisheye_polynomial,
    CameraKind.CENTRAL_CYLINDRICAL: _central_cylindrical,
}


@wp.func
def panorama_direction_of(kind: int, numbers: wp.vec4, more: wp.vec4, x: float, y: float) -> wp.vec3:
    """`panorama_direction` of the panorama of this `CameraKind`."""
    if kind == wp.static(int(CameraKind.EQUIRECTANGULAR)):
        return _equirectangular(numbers, more, x, y)
    if kind == wp.static(int(CameraKind.EQUIANGULAR_CUBEMAP_FACE)):
        return _equiangular_cubemap_face(numbers, more, x, y)
    if kind == wp.static(int(CameraKind.MIRROR_BALL)):
        return _mirror_ball(numbers, more, x, y)
    if kind == wp.static(int(CameraKind.FISHEYE_EQUIDISTANT)):
        return _fisheye_equidistant(numbers, more, x, y)
    if kind == wp.static(int(CameraKind.FISHEYE_EQUISOLID)):
        return _fisheye_equisolid(numbers, more, x, y)
    if kind == wp.static(int(CameraKind.FISHEYE_POLYNOMIAL)):
        return _fisheye_polynomial(numbers, more, x, y)
    return _central_cylindrical(numbers, more, x, y)


def make_panorama_direction(kind: CameraKind) -> wp.Function:
    """`panorama_direction(numbers, more, x, y)`: the unit vector in the camera's axes that the point (x, y) looks
    along, 0 where it sees nothing; `numbers` and `more` are the halves of `panorama_numbers`.
    """
    return _DIRECTIONS[kind]


# Steps of Newton's method for the root of a lens polynomial, as in Cycles
_ROOT_STEPS = 20


@wp.func
def _polynomial_radius(more: wp.vec4, first: float, theta: float) -> float:
    """The distance from the middle at which the polynomial of a lens is `theta` [rad]."""
    r = float(0.0)
    if more[0] != 0.0:
        r = (theta - first) / more[0]
    for _ in range(_ROOT_STEPS):
        value = first + r * (more[0] + r * (more[1] + r * (more[2] + r * more[3])))
        slope = more[0] + r * (2.0 * more[1] + r * (3.0 * more[2] + r * 4.0 * more[3]))
        if slope == 0.0:
            break
        step = (theta - value) / slope
        r += step
        if not (wp.abs(step) >= 1e-6):
            break
    return r


@wp.func
def panorama_place_of(kind: int, numbers: wp.vec4, more: wp.vec4, direction: wp.vec3) -> wp.vec2:
    """The point of the picture of a panorama of this `CameraKind` that looks along the unit vector `direction` in the
    camera's axes, the inverse of `panorama_direction_of`; also beyond what the picture shows. Not finite where there is
    no such point.
    """
    x = direction[0]
    y = direction[1]
    ahead = -direction[2]
    if kind == wp.static(int(CameraKind.EQUIRECTANGULAR)):
        latitude = wp.atan2(y, wp.sqrt(x * x + ahead * ahead))
        return wp.vec2((wp.atan2(x, ahead) - numbers[0]) / numbers[1], (latitude - numbers[2]) / numbers[3])
    if kind == wp.static(int(CameraKind.CENTRAL_CYLINDRICAL)):
        height = y / wp.sqrt(x * x + ahead * ahead)
        return wp.vec2((wp.atan2(x, ahead) - numbers[0]) / numbers[1], (height - numbers[2]) / numbers[3])
    if kind == wp.static(int(CameraKind.EQUIANGULAR_CUBEMAP_FACE)):
        return wp.vec2(
            0.5 + wp.atan2(x, ahead) * wp.static(2.0 / math.pi), 0.5 + wp.atan2(y, ahead) * wp.static(2.0 / math.pi)
        )
    if kind == wp.static(int(CameraKind.MIRROR_BALL)):
        twice = 2.0 * wp.sqrt(wp.max(0.5 + 0.5 * ahead, 0.0))
        return wp.vec2(0.5 + 0.5 * x / twice, 0.5 + 0.5 * y / twice)
    # fisheyes: by the angle from the view axis
    beside = wp.sqrt(x * x + y * y)
    theta = wp.atan2(beside, ahead)
    u = float(0.0)
    v = float(0.0)
    if beside > 0.0:
        u = x / beside
        v = y / beside
    if kind == wp.static(int(CameraKind.FISHEYE_EQUIDISTANT)):
        r = 0.5 * theta / numbers[0]
        return wp.vec2(0.5 + r * u, 0.5 + r * v)
    if kind == wp.static(int(CameraKind.FISHEYE_EQUISOLID)):
        r = wp.sin(0.5 * theta)
        return wp.vec2(0.5 + r * u / numbers[0], 0.5 + r * v / numbers[1])
    r = _polynomial_radius(more, numbers[3], -theta)
    return wp.vec2(0.5 + r * u / numbers[0], 0.5 + r * v / numbers[1])


def pixel_angle(kind: CameraKind, panorama: Panorama, window: tuple[float, ...], width: int, height: int) -> float:
    """About the angle that a pixel in the middle of the frame spans, the mean of both axes [rad]."""
    numbers = panorama_numbers(kind, panorama)
    across, up = {
        CameraKind.EQUIRECTANGULAR: lambda: (numbers[1], numbers[3]),
        CameraKind.EQUIANGULAR_CUBEMAP_FACE: lambda: (math.pi / 2, math.pi / 2),
        CameraKind.MIRROR_BALL: lambda: (4.0, 4.0),
        CameraKind.FISHEYE_EQUIDISTANT: lambda: (2 * numbers[0], 2 * numbers[0]),
        CameraKind.FISHEYE_EQUISOLID: lambda: (2 * numbers[0], 2 * numbers[1]),
        CameraKind.FISHEYE_POLYNOMIAL: lambda: (numbers[4] * numbers[0], numbers[4] * numbers[1]),
        CameraKind.CENTRAL_CYLINDRICAL: lambda: (numbers[1], numbers[3]),
    }[kind]()
    left, right, bottom, top = window
    steps = np.abs([across * (right - left) / width, up * (top - bottom) / height])
    return float(steps.mean())
