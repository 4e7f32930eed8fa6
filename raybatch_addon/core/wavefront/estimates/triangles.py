"""The mean radiance of triangles whose material is a program."""

from __future__ import annotations

import functools

import warp as wp

from ...scene.program import ProgramFeatures
from ...shading.sampling import bitangent_of, tangent_of
from ...shading.surface import make_surface
from ..scene.shading_data import SceneData
from ..stages.emitted import make_surface_emission
from .work import EstimateWork

# Points of a triangle whose mean is its emission: rows of a grid. Each is seen from a direction of its own
_ROWS = 4
_POINTS = _ROWS * (_ROWS + 1) // 2
_GOLDEN_ANGLE = 2.3999632  # between directions around the normal [radians]


@functools.cache
def make_triangle_estimate(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Function:
    """Function (data, work, i: int): mean radiance of triangle `i`, seen from the front and from the back.

    Directions are distributed by the cosine (a spiral of Fibonacci, Keinert et al. 2015), as light leaves a surface:
    what shines into a few directions alone is not as bright as straight ahead. One point more is seen straight ahead,
    so that a beam, which no other direction meets, is not taken as dark.
    """
    surface_emission = make_surface_emission(programs, instancing, smooth_normals)
    surface_point = make_surface(instancing, smooth_normals).point

    @wp.func
    def triangle_estimate(data: SceneData, work: EstimateWork, i: int):
        instance, primitive = work.instance[i], work.primitive[i]
        total = wp.vec3(0.0)
        row = int(0)
        column = int(0)
        # counts are variables: unrolled, the loops would hold 22 interpreters
        points = int(_POINTS + 1)
        sides = int(2)
        for k in range(points):
            place = wp.vec2(float(row) + 0.33, float(column) + 0.33) / float(_ROWS)
            normal = surface_point(data.geometry, instance, primitive, place, 0.5).geometric_normal
            square = (float(k) + 0.5) / float(_POINTS)
            if k == _POINTS:
                square = float(0.0)
            angle = float(k) * _GOLDEN_ANGLE
            across = wp.sqrt(square) * (wp.cos(angle) * tangent_of(normal) + wp.sin(angle) * bitangent_of(normal))
            ahead = wp.sqrt(1.0 - square) * normal
            for _ in range(sides):
                seen = surface_emission(data, instance, primitive, place, ahead + across, 1.0, 1, 0, 0)
                total += wp.max(seen, wp.vec3(0.0))
                ahead = -ahead
            column += 1
            if row + column == _ROWS:
                row += 1
                column = int(0)
            if row == _ROWS:  # straight ahead from the middle
                row = int(1)
                column = int(1)
        work.radiance[i] = wp.min(total / float(sides * points), wp.vec3(1e30))

    return triangle_estimate
