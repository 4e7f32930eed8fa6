"""Shapes of area lights, to be sampled and to be met as in `shapes.py`.

They are rectangles and ellipses that shine from one side. A surface in the plane of a light is behind it.
"""

import numpy as np
import warp as wp

from ..sampling import sample_disk, to_world
from .shapes import GAMMA_8, LightSample, area_to_solid_angle
from .table import LightRecord

# A rectangle's solid angle is a sum of four angles of up to pi, less 2 pi: its error is about eight roundings of pi.
# Below this solid angle the error exceeds a thousandth, and uniform points on the rectangle serve as well: it is small
# and seen as a whole
_SOLID_ANGLE_MIN = wp.constant(8.0 * np.pi * float(np.finfo(np.float32).eps) * 1000.0)

# A share of the distance that `distance_error` of an area light does not exceed: rays that graze the light, or are far
# from where all is, would pass what is well before it
ERROR_SHARE_MOST = 2.0**-10


@wp.struct
class AreaTarget:
    """The part of a rectangle or ellipse that is sampled, seen from the shaded point.

    Coordinates along the light's axes [m]; the shaded point is at (0, 0), the light in the plane `height` away.
    """

    height: float  # <= 0: the point is on the light's back, or nothing of the light reaches it
    x0: float
    x1: float
    y0: float
    y1: float
    ellipse: int  # 1: the target is the ellipse within these bounds, with uniform points; 0: the rectangle


@wp.func
def rectangle_area(target: AreaTarget) -> float:
    """Area of the bounds [m²]."""
    return (target.x1 - target.x0) * (target.y1 - target.y0)


@wp.func
def rectangle_corner_angle(x: float, y: float, height: float, sign: float) -> float:
    """Angle between the two planes through the shaded point and the edges that meet in corner (x, y)."""
    return wp.atan2(height * wp.sqrt(x * x + y * y + height * height), sign * x * y)


@wp.func
def rectangle_solid_angle(target: AreaTarget) -> float:
    """Solid angle of the bounds [sr]: the excess of their corner angles."""
    h = target.height
    lower = rectangle_corner_angle(target.x1, target.y0, h, 1.0) + rectangle_corner_angle(target.x0, target.y0, h, -1.0)
    upper = rectangle_corner_angle(target.x1, target.y1, h, -1.0) + rectangle_corner_angle(target.x0, target.y1, h, 1.0)
    return lower + upper - wp.TAU


@wp.func
def sample_spherical_rectangle(target: AreaTarget, solid_angle: float, u: wp.vec2) -> wp.vec2:
    """A point of the bounds, uniform in solid angle; (x, y) [m].

    Urena, Fajardo and King, "An Area-Preserving Parametrization for Spherical Rectangles", 2013, section 4, with the
    second inversion written so that it does not cancel.
    """
    h = target.height
    x0 = target.x0
    y0 = target.y0
    y1 = target.y1
    b0 = -y0 / wp.sqrt(h * h + y0 * y0)
    b1 = y1 / wp.sqrt(h * h + y1 * y1)
    # the angles of the two corners at x0 turn to the part of the solid angle left of x
    angle = u[0] * solid_angle + wp.TAU
    angle = angle - rectangle_corner_angle(x0, y1, h, 1.0) - rectangle_corner_angle(x0, y0, h, -1.0)
    f = (wp.cos(angle) * b0 - b1) / wp.sin(angle)
    # x / h = c / sqrt(1 - c^2) with c = sign(f) / sqrt(f^2 + b0^2)
    below = f * f - h * h / (h * h + y0 * y0)
    x = x0
    if below > 0.0:
        x = wp.where(f > 0.0, h, -h) / wp.sqrt(below)
    else:
        x = wp.where(f > 0.0, target.x1, x0)
    x = wp.clamp(x, x0, target.x1)

    # y / d is the tangent of an angle whose sine is uniform between those of y0 and y1
    d_squared = x * x + h * h
    r0 = wp.sqrt(d_squared + y0 * y0)
    r1 = wp.sqrt(d_squared + y1 * y1)
    sine = wp.lerp(y0 / r0, y1 / r1, u[1])
    above0 = wp.where(y0 > 0.0, d_squared / (r0 * (r0 + y0)), 1.0 - y0 / r0)
    above1 = wp.where(y1 > 0.0, d_squared / (r1 * (r1 + y1)), 1.0 - y1 / r1)
    below0 = wp.where(y0 < 0.0, d_squared / (r0 * (r0 - y0)), 1.0 + y0 / r0)
    below1 = wp.where(y1 < 0.0, d_squared / (r1 * (r1 - y1)), 1.0 + y1 / r1)
    cosine_squared = wp.lerp(above0, above1, u[1]) * wp.lerp(below0, below1, u[1])
    y = sine * wp.sqrt(d_squared / cosine_squared)
    return wp.vec2(x, wp.clamp(y, y0, y1))


@wp.func
def area_target(light: LightRecord, position: wp.vec3, ellipse: int) -> AreaTarget:
    """The part of a RECTANGLE or ELLIPSE to sample from `position`.

    With a spread it is no more than the bounds of the circle on the light whose points shine as far as `position`.
    """
    offset = position - light.position
    x = wp.dot(offset, light.axis_x)
    y = wp.dot(offset, light.axis_y)
    target = AreaTarget()
    target.height = wp.dot(offset, light.axis)
    target.x0 = -light.half_x - x
    target.x1 = light.half_x - x
    target.y0 = -light.half_y - y
    target.y1 = light.half_y - y
    target.ellipse = ellipse
    if light.spread_scale > 0.0 and target.height > 0.0:
        reach = target.height * light.tan_half_spread
        part = AreaTarget()
        part.height = target.height
        part.x0 = wp.max(target.x0, -reach)
        part.x1 = wp.min(target.x1, reach)
        part.y0 = wp.max(target.y0, -reach)
        part.y1 = wp.min(target.y1, reach)
        if part.x0 >= part.x1 or part.y0 >= part.y1:
            target.height = 0.0
        elif ellipse == 0 or rectangle_area(part) < 0.25 * wp.PI * rectangle_area(target):
            return part
    return target


@wp.func
def area_target_pdf(target: AreaTarget, solid_angle: float, x: float, y: float) -> float:
    """Density of the direction to (x, y) of the target [1/sr]; `solid_angle` is that of its bounds."""
    distance_squared = x * x + y * y + target.height * target.height
    if target.ellipse != 0:
        return area_to_solid_angle(distance_squared, target.height, 0.25 * wp.PI * rectangle_area(target))
    if solid_angle > _SOLID_ANGLE_MIN:
        return 1.0 / solid_angle
    return area_to_solid_angle(distance_squared, target.height, rectangle_area(target))


@wp.func
def area_falloff(light: LightRecord, beside: float, height: float) -> float:
    """Radiance of an area light towards a point, relative to its radiance along the normal.

    The point is `beside` [m] off the normal and `height` [m] above the light.
    """
    return wp.max(1.0 - (beside / height) * light.spread_scale, 0.0)


@wp.func
def outside_ellipse(light: LightRecord, target_x: float, target_y: float) -> bool:
    """Whether a point of the light's plane, relative to its centre [m], misses the ellipse."""
    x = target_x / light.half_x
    y = target_y / light.half_y
    return x * x + y * y > 1.0


@wp.func
def plane_distance_error(light: LightRecord, direction: wp.vec3, distance: float) -> float:
    """Bound of how much nearer than `distance` a ray along `direction` may find a surface that lies in the light's
    plane, such as the ceiling of a lamp that is flush with it [m].

    Rounding moves the planes of both, or the ray, by at most `error` along each axis; the slant of the ray stretches
    the part along the normal.
    """
    error = wp.vec3(distance)
    for i in range(3):
        reach = wp.abs(light.axis_x[i]) * light.half_x + wp.abs(light.axis_y[i]) * light.half_y
        error[i] = error[i] + reach + wp.abs(light.position[i])
    slant = wp.abs(wp.dot(direction, light.axis))
    bound = wp.static(4.0 * GAMMA_8) * wp.dot(wp.abs(light.axis), error)
    return wp.min(bound / slant, wp.static(ERROR_SHARE_MOST) * distance)


@wp.func
def sample_area_light(light: LightRecord, position: wp.vec3, u: wp.vec2, ellipse: int) -> LightSample:
    """A direction to the part of a RECTANGLE or ELLIPSE that lights `position`; `radiance` holds the falloff."""
    s = LightSample()
    target = area_target(light, position, ellipse)
    if target.height <= 0.0:
        return s
    solid_angle = float(0.0)
    p = wp.vec2()
    if target.ellipse != 0:
        d = sample_disk(u)
        p = wp.vec2(
            0.5 * (target.x0 + target.x1) + d[0] * light.half_x, 0.5 * (target.y0 + target.y1) + d[1] * light.half_y
        )
    else:
        solid_angle = rectangle_solid_angle(target)
        if solid_angle > _SOLID_ANGLE_MIN:
            p = sample_spherical_rectangle(target, solid_angle, u)
        else:
            p = wp.vec2(wp.lerp(target.x0, target.x1, u[0]), wp.lerp(target.y0, target.y1, u[1]))
        if ellipse != 0:
            offset = position - light.position
            if outside_ellipse(light, p[0] + wp.dot(offset, light.axis_x), p[1] + wp.dot(offset, light.axis_y)):
                return s
    s.distance = wp.sqrt(p[0] * p[0] + p[1] * p[1] + target.height * target.height)
    s.direction = to_world(wp.vec3(p[0], p[1], -target.height), light.axis_x, light.axis_y, light.axis)
    s.distance_error = plane_distance_error(light, s.direction, s.distance)
    s.pdf = area_target_pdf(target, solid_angle, p[0], p[1])
    s.radiance = wp.vec3(area_falloff(light, wp.length(p), target.height))
    return s


@wp.func
def meet_area_light(light: LightRecord, origin: wp.vec3, direction: wp.vec3, ellipse: int) -> LightSample:
    """Hit of a ray with the front of a RECTANGLE or ELLIPSE; `radiance` holds the falloff."""
    s = LightSample()
    offset = origin - light.position
    height = wp.dot(offset, light.axis)
    down = -wp.dot(direction, light.axis)
    if height <= 0.0 or down <= 0.0:
        return s
    distance = height / down
    x = wp.dot(direction, light.axis_x) * distance
    y = wp.dot(direction, light.axis_y) * distance
    from_centre_x = x + wp.dot(offset, light.axis_x)
    from_centre_y = y + wp.dot(offset, light.axis_y)
    if wp.abs(from_centre_x) > light.half_x or wp.abs(from_centre_y) > light.half_y:
        return s
    if ellipse != 0:
        if outside_ellipse(light, from_centre_x, from_centre_y):
            return s
    falloff = area_falloff(light, wp.sqrt(x * x + y * y), height)
    target = area_target(light, origin, ellipse)
    if falloff > 0.0 and target.height > 0.0:
        solid_angle = float(0.0)
        if target.ellipse == 0:
            solid_angle = rectangle_solid_angle(target)
        s.distance = distance
        s.distance_error = plane_distance_error(light, direction, distance)
        s.pdf = area_target_pdf(target, solid_angle, x, y)
        s.radiance = wp.vec3(falloff)
    return s


@wp.func
def sample_parallel_light(light: LightRecord, position: wp.vec3, ellipse: int) -> LightSample:
    """The one direction in which an area light of no spread reaches `position`."""
    s = LightSample()
    offset = position - light.position
    height = wp.dot(offset, light.axis)
    x = wp.dot(offset, light.axis_x)
    y = wp.dot(offset, light.axis_y)
    lit = height > 0.0 and wp.abs(x) <= light.half_x and wp.abs(y) <= light.half_y
    if lit and ellipse != 0:
        lit = not outside_ellipse(light, x, y)
    if lit:
        s.direction = -light.axis
        s.distance = height
        s.distance_error = plane_distance_error(light, s.direction, s.distance)
        s.pdf = 1.0
    return s
