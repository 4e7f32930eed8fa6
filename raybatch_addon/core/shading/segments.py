"""The surface at a hit of a curve's segment or of a point, which are `scene/segments.py`'s primitives.

A hit's two numbers say where on the surface it is. On a segment the first is the place along the axis, 0 at its first
point and 1 at its second, and the second number the direction around it: |v| runs from 0 to 2 along the edge of a
square, on the side that the sign says. On a sphere both are those of the normal on an octahedron. Corner values do not
depend on the second number, since the third corner of a segment has what the first has.
"""

from __future__ import annotations

import functools

import warp as wp

from ..float32 import UNIT_ROUNDOFF
from ..native.build import native_source
from ..scene.geometry import Geometry, corners_of, transform_vector
from ..scene.moved import positions_at, step_place, transform_at
from ..scene.segments import COORDINATE_BITS, COORDINATE_MASK, NORMAL_STEPS, RADIUS_BITS, RADIUS_MASK, RADIUS_SHIFT
from .surface import SurfacePoint, carried_error, make_surface, material_of, moved_normal, unit_or_zero

# What the next ray's test of a segment (`native/traverse/segments/meet.h`) may be off. Write L for the axis's length, R
# for the larger radius, S for the sum of the axis's coordinates and 2 R, s for the slope of radii, and A = sqrt(2 L^2 +
# 48 R^2) <= 3.5 S for how far along the ray the test moves its origin at most. There the ray is at x from the axis and
# the radius is r, neither more than c = rho + s A, with rho the radius at the hit:
#
# - x, product and difference across the axis, product and sum of the move: 4 u S a coordinate, which
#   is 14 u S |x| of x x, and its own three roundings:                                17 u S c
# - r, two roundings of radii, and the place along the axis, 8 u S of the origin's and 9 u A of the
#   speed's and the move, times the slope: of r r                                     2 u S c + 80 u s S c
# - r r, b b - a c, its root and the quotient, where c <= 4.5 S sqrt(1 + s s):        11 u c c
#
# The root is found to what x x - r r is known to. At the hit |x| + r is 2 rho, and the cone is nearer by sqrt(1 + s s):
# the hit is within **75 u S c / rho** of it, without what the way from the ray's origin costs, 14 u of its length
# (docs/stability.md), which is in S for a ray that leaves. A ribbon's test has no squares: 20 u S.
#
# Of steep cones that is much too far. The test takes no hit where the radius would be below 0 or above 2 R, thus none
# farther along the axis from the cone than 2 R / s, but for what it knows of the place along the axis, which is in
# 75 u S. A ray that starts 2 R / s outside, s above 0.6, is where the radius is below 0, and as it turns away from the
# cone, it stays R or more outside where that is above 0 again. The hit is within **75 u S + 2 R / s** at most.
_SEGMENT_TEST = 75.0 * UNIT_ROUNDOFF
# Slopes above it count as this one, so that nothing overflows: the other bound is the smaller one long before
_STEEPEST = 1e6


@wp.struct
class Segment:
    """A segment in the space of its mesh."""

    first: wp.vec3  # its first point [m]
    axis: wp.vec3  # to its second point [m]; 0: a sphere
    first_radius: float  # [m]
    second_radius: float
    first_normal: wp.vec3  # of the planes at its ends, towards the second point, of any length: the curve's tangents
    second_normal: wp.vec3


@wp.func_native(native_source("math/bits.h", RESULT="int"))
def _bits_of(x: float) -> int: ...


@wp.func_native(native_source("math/bits.h", RESULT="float"))
def _float_of(x: int) -> float: ...


@wp.func
def _normal_of(bits: int) -> wp.vec3:
    x = float(bits & wp.static(COORDINATE_MASK)) * wp.static(2.0 / NORMAL_STEPS) - 1.0
    y = float((bits >> wp.static(COORDINATE_BITS)) & wp.static(COORDINATE_MASK)) * wp.static(2.0 / NORMAL_STEPS) - 1.0
    z = 1.0 - wp.abs(x) - wp.abs(y)
    fold = wp.max(-z, 0.0)
    return wp.vec3(x - wp.where(x < 0.0, -fold, fold), y - wp.where(y < 0.0, -fold, fold), z)


@wp.func
def _radius_of(radii: int, shift: int) -> float:
    """One of the two packed radii [m]; `shift` is 0 for the first, `RADIUS_BITS` for the second."""
    return _float_of(((radii >> shift) & wp.static(RADIUS_MASK)) << wp.static(RADIUS_SHIFT))


@wp.func
def is_segment(geometry: Geometry, triangle: int) -> bool:
    """Whether a primitive, numbered through all meshes, is a segment."""
    return not wp.isfinite(geometry.positions[corners_of(geometry, triangle)[2]][2])


@wp.func
def segment_of(geometry: Geometry, triangle: int) -> Segment:
    """The segment that a primitive is."""
    corners = corners_of(geometry, triangle)
    packed = geometry.positions[corners[2]]
    s = Segment()
    s.first = geometry.positions[corners[0]]
    s.axis = geometry.positions[corners[1]] - s.first
    radii = _bits_of(packed[0])
    s.first_radius = _radius_of(radii, 0)
    s.second_radius = _radius_of(radii, wp.static(RADIUS_BITS))
    s.first_normal = _normal_of(_bits_of(packed[1]))
    s.second_normal = _normal_of(_bits_of(packed[2]))
    return s


@wp.func
def _mixed_normal(before: float, behind: float, share: float) -> wp.vec3:
    """A normal between two steps, mixed as by traversal."""
    a = wp.normalize(_normal_of(_bits_of(before)))
    return a + share * (wp.normalize(_normal_of(_bits_of(behind))) - a)


@wp.func
def segment_at(geometry: Geometry, mesh: int, triangle: int, time: float) -> Segment:
    """The segment that a primitive of `mesh` is at `time`."""
    s = segment_of(geometry, triangle)
    place = step_place(geometry, mesh, time, 0)
    if place.stride != 0:
        corners = corners_of(geometry, triangle)
        first, second, _ = positions_at(geometry, mesh, wp.vec3i(corners[0], corners[1], corners[0]), time)
        before = geometry.positions[place.first + corners[2]]
        behind = geometry.positions[place.first + corners[2] + place.stride]
        s.first = first
        s.axis = second - first
        a = _bits_of(before[0])
        b = _bits_of(behind[0])
        r = _radius_of(a, 0)
        s.first_radius = r + place.share * (_radius_of(b, 0) - r)
        r = _radius_of(a, wp.static(RADIUS_BITS))
        s.second_radius = r + place.share * (_radius_of(b, wp.static(RADIUS_BITS)) - r)
        s.first_normal = _mixed_normal(before[1], behind[1], place.share)
        s.second_normal = _mixed_normal(before[2], behind[2], place.share)
    return s


@wp.func
def _outwards(unit_axis: wp.vec3, v: float) -> wp.vec3:
    """The unit vector across the axis that the second number of a hit says."""
    sign = wp.where(unit_axis[2] < 0.0, -1.0, 1.0)
    p = -1.0 / (sign + unit_axis[2])
    r = unit_axis[0] * unit_axis[1] * p
    i = 1.0 - wp.abs(v)
    j = 1.0 - wp.abs(i)
    if v < 0.0:
        j = -j
    across = i * wp.vec3(1.0 + sign * unit_axis[0] * unit_axis[0] * p, sign * r, -sign * unit_axis[0])
    across = across + j * wp.vec3(r, sign + unit_axis[1] * unit_axis[1] * p, -unit_axis[1])
    return wp.normalize(across)


@wp.func
def _on_octahedron(uv: wp.vec2) -> wp.vec3:
    z = 1.0 - wp.abs(uv[0]) - wp.abs(uv[1])
    n = wp.vec3(uv[0], uv[1], z)
    if z < 0.0:
        x = 1.0 - wp.abs(uv[1])
        y = 1.0 - wp.abs(uv[0])
        n = wp.vec3(wp.where(uv[0] < 0.0, -x, x), wp.where(uv[1] < 0.0, -y, y), z)
    return wp.normalize(n)


@wp.func
def _tangent_at(s: Segment, along: float) -> wp.vec3:
    return wp.normalize(wp.normalize(s.first_normal) * (1.0 - along) + wp.normalize(s.second_normal) * along)


@functools.cache
def make_segment_point(instancing: bool, moving: bool = False) -> wp.Function:
    """Function (geometry, instance, triangle: int, uv, time: float) -> SurfacePoint of a segment, which is numbered
    through all meshes.
    """

    @wp.func
    def segment_point(geometry: Geometry, instance: int, triangle: int, uv: wp.vec2, time: float) -> SurfacePoint:
        s = segment_of(geometry, triangle)
        if wp.static(moving):
            s = segment_at(geometry, geometry.instance_mesh[instance], triangle, time)
        radius = s.first_radius
        widens = float(0.0)  # how much the radius changes along the way to where a ray is nearest to the axis, at most
        window = float(wp.inf)  # how far from the cone the test takes a hit at most, roundings aside [m]
        unit_axis = unit_or_zero(s.axis)
        if wp.dot(unit_axis, unit_axis) > 0.5:
            length = wp.dot(unit_axis, s.axis)
            taper = s.second_radius - s.first_radius
            outwards = _outwards(unit_axis, uv[1])
            radius = s.first_radius + uv[0] * taper
            most = wp.max(s.first_radius, s.second_radius)
            change = wp.abs(taper)
            if change > 0.0:
                slope = wp.static(_STEEPEST)
                if change < slope * length:
                    slope = change / length
                widens = 1.5 * change + 7.0 * most * slope
                window = 2.0 * most * (length / change)
            position = s.first + uv[0] * s.axis + radius * outwards
            geometric = unit_or_zero(outwards * length - taper * unit_axis)
            # the curve's own tangent turns from joint to joint, and the normal with it
            tangent = _tangent_at(s, uv[0])
            across = wp.normalize(outwards - wp.dot(outwards, tangent) * tangent)
            smooth = unit_or_zero(across * length - taper * tangent)
        else:
            geometric = _on_octahedron(uv)
            position = s.first + radius * geometric
            smooth = geometric
        reach = wp.abs(s.axis[0]) + wp.abs(s.axis[1]) + wp.abs(s.axis[2])
        reach = wp.static(_SEGMENT_TEST) * (reach + 2.0 * wp.max(s.first_radius, s.second_radius))
        # the test knows squares of radii, which says less of radii where these are small
        square = reach * (radius + widens)
        window = reach + window
        if square > 0.0:
            reach = wp.min(2.0 * square / (wp.sqrt(radius * radius + 2.0 * square) + radius), window)
        surface = SurfacePoint()
        surface.error = wp.vec3(reach, reach, reach) + wp.static(3.0 * UNIT_ROUNDOFF) * wp.vec3(
            wp.abs(position[0]), wp.abs(position[1]), wp.abs(position[2])
        )
        if wp.static(instancing):
            if geometry.instancing != 0:
                matrix = geometry.instance_transform[instance]
                if wp.static(moving):
                    matrix = transform_at(geometry, instance, time)
                surface.error = carried_error(matrix, position, surface.error)
                position = transform_vector(matrix, position) + wp.vec3(matrix[0, 3], matrix[1, 3], matrix[2, 3])
                geometric = unit_or_zero(moved_normal(matrix, geometric))
                smooth = unit_or_zero(moved_normal(matrix, smooth))
        surface.position = position
        surface.geometric_normal = geometric
        surface.normal = smooth
        if not (wp.dot(smooth, geometric) > 0.0):
            surface.normal = geometric
        surface.material = material_of(geometry, instance, triangle)
        if wp.static(moving):
            surface.time = time
        return surface

    return segment_point


@wp.func
def segment_tangent(geometry: Geometry, instance: int, triangle: int, uv: wp.vec2, time: float) -> wp.vec3:
    """The unit tangent of the curve at a hit, in world space; 0 for a sphere."""
    s = segment_at(geometry, geometry.instance_mesh[instance], triangle, time)
    if wp.dot(s.axis, s.axis) == 0.0:
        return wp.vec3(0.0)
    return unit_or_zero(transform_vector(transform_at(geometry, instance, time), _tangent_at(s, uv[0])))


@functools.cache
def make_surface_point(instancing: bool, smooth_normals: bool, curves: bool, moving: bool = False) -> wp.Function:
    """`make_surface(...).point`, for segments too where there are `curves`."""
    triangle_point = make_surface(instancing, smooth_normals, moving).point
    if not curves:
        return triangle_point
    segment_point = make_segment_point(instancing, moving)

    @wp.func
    def surface_point(geometry: Geometry, instance: int, primitive: int, uv: wp.vec2, time: float) -> SurfacePoint:
        triangle = geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive
        if is_segment(geometry, triangle):
            return segment_point(geometry, instance, triangle, uv, time)
        return triangle_point(geometry, instance, primitive, uv, time)

    return surface_point


@functools.cache
def make_is_closed(curves: bool) -> wp.Function:
    """Function (geometry, instance: int, primitive: int) -> bool: whether a primitive may be part of a surface that
    has an inside. Segments of curves have none: rays meet them from outside alone.
    """

    @wp.func
    def is_closed(geometry: Geometry, instance: int, primitive: int) -> bool:
        if wp.static(curves):
            return not is_segment(geometry, geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive)
        return True

    return is_closed
