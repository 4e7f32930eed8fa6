"""The brightness of the world by direction, where a program computes it."""

from __future__ import annotations

import functools

import warp as wp

from ...scene.program import ProgramFeatures
from ...shading.lights.world import texel_direction
from ..scene.shading_data import SceneData
from ..stages.emitted import make_world_emission
from .work import EstimateWork


@functools.cache
def make_world_estimate(programs: ProgramFeatures) -> wp.Function:
    """Function (data, work, i: int): mean brightness of a texel over `points` points along either axis, or brightness
    of a direction.
    """
    world_emission = make_world_emission(programs)

    @wp.func
    def world_estimate(data: SceneData, work: EstimateWork, i: int):
        aimed = work.directions.shape[0] > 0
        texel = work.row_first * work.world.width + i
        points = work.points
        row, column = int(0), int(0)
        if aimed:
            texel = i
            points = 1
        else:
            if work.listed.shape[0] > 0:
                texel = work.listed[i]
            row = texel / work.world.width
            column = texel % work.world.width
        total = float(0.0)
        for k in range(points * points):
            direction = wp.vec3()
            if aimed:
                direction = work.directions[i]
            else:
                u = wp.vec2(float(k % points) + 0.5, float(k / points) + 0.5) / float(points)
                direction = texel_direction(work.world, row, column, u)
            radiance = world_emission(data, wp.vec3(0.0), direction, 0, 1, 0)
            total += (radiance[0] + radiance[1] + radiance[2]) * wp.static(1.0 / 3.0)
        work.texels[texel] = wp.min(total / float(points * points), wp.static(1e30))

    return world_estimate
