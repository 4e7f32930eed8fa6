"""The surface at a hit: its point and the bound of that point's error, its normals, and its material."""

from __future__ import annotations

import functools
from typing import NamedTuple

import warp as wp

from ..bvh.margin import TRIANGLE_TEST
from ..float32 import UNIT_ROUNDOFF, roundoff
from ..scene.geometry import Geometry, corners_of, image_reach, mat34, transform_vector
from ..scene.moved import normals_at, positions_at, transform_at

_GAMMA_3, _GAMMA_8 = roundoff(3), roundoff(8)
_TRIANGLE_TEST = TRIANGLE_TEST / (1 - TRIANGLE_TEST)


@wp.struct
class SurfacePoint:
    """A point on a triangle, in world space."""

    position: wp.vec3  # [m]
    error: wp.vec3  # bound of the error of each coordinate, and of the ray test at the point [m]
    geometric_normal: wp.vec3  # unit, of the front
    normal: wp.vec3  # unit, interpolated; on the same side as `geometric_normal`
    material: int
    time: float  # when it is there, 0 to 1; 0 where nothing moves


class SurfaceFunctions(NamedTuple):
    """Warp functions of one specialisation."""

    point: wp.Function  # (geometry, instance, primitive, uv, time) -> SurfacePoint


@wp.func
def spawn_origin(position: wp.vec3, error: wp.vec3, normal: wp.vec3, direction: wp.vec3) -> wp.vec3:
    """Origin of a ray that leaves the surface at `position` towards `direction` and cannot meet it again.

    The origin is moved along the normal to the outside of the box of possible positions, then rounded away from the
    surface (Pharr, Jakob and Humphreys 2023, section 6.8.6).
    """
    reach = wp.dot(wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2])), error)
    offset = normal * reach
    if wp.dot(normal, direction) < 0.0:
        offset = -offset
    return wp.vec3(
        _rounded_away(position[0] + offset[0], offset[0]),
        _rounded_away(position[1] + offset[1], offset[1]),
        _rounded_away(position[2] + offset[2], offset[2]),
    )


@wp.func
def _rounded_away(x: float, towards: float) -> float:
    # one rounding of the sum above, at most half a unit in the last place of x
    step = wp.abs(x) * wp.static(2.0 * UNIT_ROUNDOFF)
    if towards > 0.0:
        return x + step
    if towards < 0.0:
        return x - step
    return x


@wp.func
def _abs(v: wp.vec3) -> wp.vec3:
    return wp.vec3(wp.abs(v[0]), wp.abs(v[1]), wp.abs(v[2]))


@wp.func
def _offset(m: mat34) -> wp.vec3:
    return wp.vec3(m[0, 3], m[1, 3], m[2, 3])


@wp.func
def _cofactor(m: mat34, n: wp.vec3) -> wp.vec3:
    """Normal `n` under `m`, by the cofactor matrix, signed so that the front of mirrored objects stays the front."""
    r0 = wp.vec3(m[0, 0], m[0, 1], m[0, 2])
    r1 = wp.vec3(m[1, 0], m[1, 1], m[1, 2])
    r2 = wp.vec3(m[2, 0], m[2, 1], m[2, 2])
    c0 = wp.cross(r1, r2)
    turned = wp.vec3(wp.dot(c0, n), wp.dot(wp.cross(r2, r0), n), wp.dot(wp.cross(r0, r1), n))
    if wp.dot(r0, c0) < 0.0:
        return -turned
    return turned


@wp.func
def _unit(v: wp.vec3) -> wp.vec3:
    """`v` at length 1, also where its square leaves the range of float32; 0 stays 0."""
    largest = wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2])))
    if largest == 0.0:
        return v
    return wp.normalize(v / largest)


@wp.func
def material_of(geometry: Geometry, instance: int, triangle: int) -> int:
    """The material of a triangle of an instance; triangles are numbered through all meshes."""
    slot = geometry.instance_slot_first[instance]
    if geometry.triangle_slot.shape[0] > 0:
        slot += geometry.triangle_slot[triangle]
    return geometry.slot_materials[slot]


@wp.func
def material_at(geometry: Geometry, instance: int, primitive: int) -> int:
    """The material that a ray met; primitives are numbered as in hits, in their mesh."""
    return material_of(geometry, instance, geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive)


@wp.func
def carried_error(m: mat34, position: wp.vec3, error: wp.vec3) -> wp.vec3:
    """Bound of the error of `position`, known to `error`, when `m` carries it to the world, and a ray back."""
    return image_reach(m, error) + wp.static(2.0 * _GAMMA_8) * (image_reach(m, _abs(position)) + _abs(_offset(m)))


@wp.func
def moved_normal(m: mat34, n: wp.vec3) -> wp.vec3:
    """Normal `n` under `m`, of any length."""
    return _cofactor(m, n)


@wp.func
def unit_or_zero(v: wp.vec3) -> wp.vec3:
    """`v` at length 1; 0 stays 0."""
    return _unit(v)


@functools.cache
def make_surface(instancing: bool, smooth_normals: bool, moving: bool = False) -> SurfaceFunctions:
    """Functions for scenes with or without instances, interpolated normals, and things that move."""

    @wp.func
    def point(geometry: Geometry, instance: int, primitive: int, uv: wp.vec2, time: float) -> SurfacePoint:
        triangle = geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive
        corners = corners_of(geometry, triangle)
        p0 = geometry.positions[corners[0]]
        p1 = geometry.positions[corners[1]]
        p2 = geometry.positions[corners[2]]
        if wp.static(moving):
            p0, p1, p2 = positions_at(geometry, geometry.instance_mesh[instance], corners, time)

        surface = SurfacePoint()
        # The point is computed from one corner along the edges. Whatever the weights are, that is a point of the
        # plane, but for three roundings in proportion to the edges, and one of the sum. Three weighted corners would
        # be off by eight roundings of their coordinates. The test of a ray that starts here takes corners relative to
        # its origin and mixes their coordinates, so that its error is in proportion to the triangle too: no corner is
        # farther away than the longest edge.
        edge_1 = p1 - p0
        edge_2 = p2 - p0
        position = p0 + (uv[0] * edge_1 + uv[1] * edge_2)
        longest = wp.max(wp.max(_abs(edge_1)), wp.max(wp.max(_abs(edge_2)), wp.max(_abs(edge_2 - edge_1))))
        tested = wp.static(_TRIANGLE_TEST) * longest
        error = (
            wp.static(_GAMMA_3) * (_abs(edge_1) + _abs(edge_2))
            + wp.vec3(tested, tested, tested)
            + wp.static(2.0 * UNIT_ROUNDOFF) * _abs(position)
        )
        edge_cross = wp.cross(edge_1, edge_2)
        if wp.static(instancing):
            if geometry.instancing != 0:
                matrix = geometry.instance_transform[instance]
                if wp.static(moving):
                    matrix = transform_at(geometry, instance, time)
                moved = transform_vector(matrix, position)
                offset = _offset(matrix)
                # error of carrying the point to the world, and the ray to the object and back
                error = image_reach(matrix, error) + wp.static(2.0 * _GAMMA_8) * (
                    image_reach(matrix, _abs(position)) + _abs(offset)
                )
                position = moved + offset
                edge_cross = _cofactor(matrix, edge_cross)
        surface.position = position
        if wp.static(moving):
            surface.time = time
        surface.error = error
        surface.geometric_normal = _unit(edge_cross)
        surface.normal = surface.geometric_normal
        if wp.static(smooth_normals):
            if geometry.corner_normals.shape[0] > 0:
                n = (1.0 - uv[0] - uv[1]) * geometry.corner_normals[3 * triangle]
                n = (
                    n
                    + uv[0] * geometry.corner_normals[3 * triangle + 1]
                    + uv[1] * geometry.corner_normals[3 * triangle + 2]
                )
                if wp.static(moving):
                    n0, n1, n2 = normals_at(geometry, geometry.instance_mesh[instance], triangle, time)
                    n = (1.0 - uv[0] - uv[1]) * n0 + uv[0] * n1 + uv[1] * n2
                if wp.static(instancing):
                    if geometry.instancing != 0:
                        if wp.static(moving):
                            n = _cofactor(transform_at(geometry, instance, time), n)
                        else:
                            n = _cofactor(geometry.instance_transform[instance], n)
                n = _unit(n)
                if wp.dot(n, n) > 0.5:  # normals of flat meshes are 0
                    surface.normal = n
        if wp.dot(surface.normal, surface.geometric_normal) < 0.0:
            surface.normal = -surface.normal

        surface.material = material_of(geometry, instance, triangle)
        return surface

    return SurfaceFunctions(point)
