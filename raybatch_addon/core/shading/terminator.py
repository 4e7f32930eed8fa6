"""Where shadow rays begin on smooth meshes of few faces: above the faces, where the surface would be that its normals
tell of. At the faces they would be stopped by neighbours which that surface does not have, at the edge of its own shade
(Cycles' Geometry Offset of the shadow terminator).
"""

from __future__ import annotations

import functools

import warp as wp

from ..scene.geometry import Geometry, corners_of, transform_vector
from ..scene.moved import normals_at, positions_at, transform_at
from .bsdf.materials import ShadingFrame
from .surface import unit_or_zero


@wp.func
def _height(n: wp.vec3, a: wp.vec3, b: wp.vec3, side: float) -> float:
    """How high a corner's plane of the normal `n` is above the triangle at most; `a`, `b`: its edges to the others."""
    return wp.max(wp.max(side * wp.dot(a, n), side * wp.dot(b, n)), 0.0)


@wp.func
def lifted_share(cutoff: float, along_normal: float, along_face: float) -> float:
    """Share of the whole way to the smooth surface that a ray begins at, 0 to 1; the numbers are cosines of the light's
    direction, `along_normal` >= 0, and `cutoff` is the setting.
    """
    if along_normal < cutoff:
        return wp.clamp(2.0 - (along_face + along_normal) / cutoff, 0.0, 1.0)
    return wp.clamp(1.0 - along_face / cutoff, 0.0, 1.0)


@functools.cache
def make_terminator_lift(instancing: bool, moving: bool) -> wp.Function:
    """Function (geometry, instance: int, primitive: int, uv: vec2, frame: ShadingFrame, direction: vec3, cutoff: float,
    time: float) -> vec3: from a triangle's point to where a shadow ray towards `direction` begins [m]. It is on the
    side of the face that light in this direction by the shading normal comes from. `cutoff`: the setting, above 0.
    """

    @wp.func
    def terminator_lift(
        geometry: Geometry,
        instance: int,
        primitive: int,
        uv: wp.vec2,
        frame: ShadingFrame,
        direction: wp.vec3,
        cutoff: float,
        time: float,
    ) -> wp.vec3:
        along_normal = wp.dot(frame.normal, direction)
        face = frame.geometric_normal
        if along_normal < 0.0:
            along_normal = -along_normal
            face = -face
        share = lifted_share(cutoff, along_normal, wp.dot(face, direction))
        if share <= 0.0 or geometry.corner_normals.shape[0] == 0:
            return wp.vec3(0.0, 0.0, 0.0)
        mesh = geometry.instance_mesh[instance]
        triangle = geometry.mesh_triangle_first[mesh] + primitive
        corners = corners_of(geometry, triangle)
        p0 = geometry.positions[corners[0]]
        p1 = geometry.positions[corners[1]]
        p2 = geometry.positions[corners[2]]
        n0 = geometry.corner_normals[3 * triangle]
        n1 = geometry.corner_normals[3 * triangle + 1]
        n2 = geometry.corner_normals[3 * triangle + 2]
        if wp.static(moving):
            p0, p1, p2 = positions_at(geometry, mesh, corners, time)
            n0, n1, n2 = normals_at(geometry, mesh, triangle, time)
        n0 = unit_or_zero(n0)
        n1 = unit_or_zero(n1)
        n2 = unit_or_zero(n2)
        u = 1.0 - uv[0] - uv[1]
        n = u * n0 + uv[0] * n1 + uv[1] * n2
        up = n
        if wp.static(instancing):
            if geometry.instancing != 0:
                matrix = geometry.instance_transform[instance]
                if wp.static(moving):
                    matrix = transform_at(geometry, instance, time)
                up = transform_vector(matrix, n)
        # by a parabola through the corners whose slopes are those of the normals
        a = wp.dot(n2 - n0, p0 - p2)
        b = wp.dot(n2 - n1, p1 - p2)
        c = wp.dot(n1 - n0, p1 - p0)
        bent = a * u * (u - 1.0) + (a + b + c) * u * uv[0] + b * uv[0] * (uv[0] - 1.0)
        # ... and below the planes of the corners, which are an envelope of the surface
        side = float(1.0)
        if wp.dot(up, face) <= 0.0:
            side = -1.0
        to_1 = uv[0] * (p1 - p0) + uv[1] * (p2 - p0)  # from the first corner to the point
        e1 = p1 - p0
        e2 = p2 - p0
        h0 = wp.max(_height(n0, e1, e2, side) - side * wp.dot(to_1, n0), 0.0)
        h1 = wp.max(_height(n1, -e1, e2 - e1, side) - side * wp.dot(to_1 - e1, n1), 0.0)
        h2 = wp.max(_height(n2, -e2, e1 - e2, side) - side * wp.dot(to_1 - e2, n2), 0.0)
        lift = side * wp.max(wp.min(wp.min(h0, h1), h2), 0.5 * side * bent)
        return share * lift * up

    return terminator_lift
