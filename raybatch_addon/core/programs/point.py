"""The point for which a program runs."""

from enum import IntFlag

import warp as wp


class HistoryBits(IntFlag):
    """Last scattering of a path.

    Above DEPTH_SHIFT follow three counts of DEPTH_BITS each: diffuse, glossy and transmitted scatterings. The two bits
    left from PORTAL_SHIFT on count the portals that the path has passed.
    """

    DIFFUSE = 1
    GLOSSY = 2  # reflected or transmitted, also if sharp
    SINGULAR = 4


DEPTH_SHIFT, DEPTH_BITS = 3, 9
PORTAL_SHIFT, PORTALS_MOST = DEPTH_SHIFT + 3 * DEPTH_BITS, 3


# `ShadingPoint.primitive` of points in volumes
IN_VOLUME = -2


@wp.struct
class ShadingPoint:
    """A point on a surface or lamp or in a volume, or a direction into the world; in world space.

    In the world and its volume there is no instance. For a direction (`is_direction`) `position` is the ray's origin,
    and `incoming` and all normals are the ray's direction reversed.
    """

    position: wp.vec3  # [m]
    incoming: wp.vec3  # unit, towards the origin of the ray
    normal: wp.vec3  # unit, interpolated, on the side of `incoming`
    geometric_normal: wp.vec3  # unit, of the triangle, on the side of `incoming`
    backfacing: int  # 1: the ray met the back of the surface
    instance: int  # -1: none; for a lamp its number among the lights
    primitive: int  # triangle of the instance's mesh; -1 for a lamp, IN_VOLUME in a volume
    barycentric: wp.vec2  # weights of the triangle's second and third corner
    ray_length: float  # distance from the ray's origin to the point [m]
    ray_kind: int  # `Visibility` bit of the ray
    bounce: int  # scattering events of the path so far
    passed: int  # transparent surfaces that the ray has passed
    time: float  # when it is there, 0 to 1; 0 where nothing moves
    history: int  # how the path has scattered: `HistoryBits`, and counts by kind above them
    # one step aside along either axis of the surface, about a pixel wide, for bump mapping: in the world, and of
    # `barycentric`
    step_x: wp.vec3  # [m]
    step_y: wp.vec3
    step_x_barycentric: wp.vec2
    step_y_barycentric: wp.vec2


@wp.func
def is_direction(point: ShadingPoint) -> bool:
    """Whether `point` is a direction into the world."""
    return point.instance < 0 and point.primitive >= 0


# A shift says where a value is looked up: 0 here, 1 or 2 one step aside along either axis. Steps of another width have
# that width above the axis, in shares of a step
SHIFT_BITS = 2
SHIFT_UNIT = 1024


def wide_shift(axis: int, width: float) -> int:
    """The shift along `axis` by `width` steps, to the nearest of `SHIFT_UNIT` shares of a step, at least one."""
    if axis == 0 or width == 1.0:
        return axis
    return axis | max(round(width * SHIFT_UNIT), 1) << SHIFT_BITS


def shift_width(shift: int) -> float:
    """How many steps `shift` goes aside."""
    return (shift >> SHIFT_BITS) / SHIFT_UNIT if shift >> SHIFT_BITS else 1.0


@wp.func
def _steps(shift: int) -> float:
    return float(shift >> wp.static(SHIFT_BITS)) * wp.static(1.0 / SHIFT_UNIT)


@wp.func
def shifted_position(point: ShadingPoint, shift: int) -> wp.vec3:
    """The position (shift 0), or one step aside along x (1) or y (2) [m]."""
    if shift == 1:
        return point.position + point.step_x
    if shift == 2:
        return point.position + point.step_y
    if shift > 2:
        if (shift & 1) != 0:
            return point.position + _steps(shift) * point.step_x
        return point.position + _steps(shift) * point.step_y
    return point.position


@wp.func
def shifted_barycentric(point: ShadingPoint, shift: int) -> wp.vec2:
    """The barycentric weights (shift 0), or those one step aside along x (1) or y (2)."""
    if shift == 1:
        return point.barycentric + point.step_x_barycentric
    if shift == 2:
        return point.barycentric + point.step_y_barycentric
    if shift > 2:
        if (shift & 1) != 0:
            return point.barycentric + _steps(shift) * point.step_x_barycentric
        return point.barycentric + _steps(shift) * point.step_y_barycentric
    return point.barycentric
