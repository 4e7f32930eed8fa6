"""Ops that read the curve at the shaded point."""

import warp as wp

from ....shading.segments import is_segment, segment_tangent
from ...op import NodeData, op, put_vector
from ...point import ShadingPoint


@wp.func
def curve_tangent(data: NodeData, point: ShadingPoint) -> wp.vec3:
    """The unit tangent of the curve, in world space; 0 on a mesh."""
    if point.instance >= 0 and point.primitive >= 0:
        geometry = data.geometry
        triangle = geometry.mesh_triangle_first[geometry.instance_mesh[point.instance]] + point.primitive
        if is_segment(geometry, triangle):
            return segment_tangent(geometry, point.instance, triangle, point.barycentric, point.time)
    return wp.vec3(0.0)


@op("curve_tangent_normal", ">V", foldable=False)
@wp.func
def curve_tangent_normal(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
    """The direction across the curve that faces the viewer; 0 on a mesh."""
    tangent = curve_tangent(data, point)
    across = wp.vec3(0.0)
    if wp.dot(tangent, tangent) > 0.5:
        across = wp.normalize(point.incoming - wp.dot(point.incoming, tangent) * tangent)
    put_vector(data, stack, pc + 1, across)
