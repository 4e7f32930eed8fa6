"""The mean radiance of triangles whose material is a program."""

from __future__ import annotations

import functools

import warp as wp

from ...scene.program import ProgramFeatures
from ...shading.surface import make_surface
from ..scene.scene_data import SceneData
from ..stages.emitted import make_surface_emission
from .work import EstimateWork

# Points of a triangle whose mean is its emission: rows of a grid
_ROWS = 4


@functools.cache
def make_triangle_estimate(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Function:
    """Function (data, work, i: int): mean radiance of triangle `i`, seen from the front and from the back."""
    surface_emission = make_surface_emission(programs, instancing, smooth_normals)
    surface_point = make_surface(instancing, smooth_normals).point

    @wp.func
    def triangle_estimate(data: SceneData, work: EstimateWork, i: int):
        instance, primitive = work.instance[i], work.primitive[i]
        total = wp.vec3(0.0)
        points = int(0)
        # rows and sides are variables: unrolled, the loops would hold 32 interpreters
        rows = int(_ROWS)
        sides = int(2)
        for row in range(rows):
            for column in range(rows - row):
                place = wp.vec2(float(row) + 0.33, float(column) + 0.33) / float(rows)
                normal = surface_point(data.geometry, instance, primitive, place).geometric_normal
                for _ in range(sides):
                    total += surface_emission(data, instance, primitive, place, normal, 1.0, 1, 0, 0)
                    normal = -normal
                    points += 1
        work.radiance[i] = wp.min(total / float(points), wp.vec3(1e30))

    return triangle_estimate
