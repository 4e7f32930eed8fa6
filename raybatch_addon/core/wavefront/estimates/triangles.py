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

# Points of a triangle whose mean is its emission: rows of a grid
_ROWS = 4
TRIANGLE_POINTS = _ROWS * (_ROWS + 1) // 2
_GOLDEN_ANGLE = 2.3999632  # between directions around the normal [radians]


@wp.func
def _usual_part(total: float, square: float, count: float) -> float:
    """The square of the mean of `count` numbers over the mean of their squares: 1 where all are alike, and about the
    part of them that is not 0 where few are.
    """
    part = float(1.0)
    if square > 0.0 and square < wp.inf:
        part = wp.min(total * total / (count * square), 1.0)
    return part


@functools.cache
def make_triangle_estimate(programs: ProgramFeatures, instancing: bool, smooth_normals: bool) -> wp.Function:
    """Function (data, work, i: int): radiance that triangle `i` counts for, the mean of what is seen from the front and
    from the back in `work.points` directions, from a point for each; or where `work.every_point` from all points in
    each of them.

    Directions are distributed by the cosine (a spiral of Fibonacci, Keinert et al. 2015), as light leaves a surface:
    what shines into a few directions alone is not as bright as straight ahead. One direction more is straight ahead,
    so that a beam, which no other direction meets, is not taken as dark.

    A beam misses most of what is lit. Chosen by its mean there, too, it would leave other emitters with few of the
    samples where they are all there is; where it shines it is bright enough for few. So from all points a side counts
    as its mean times the part of directions into which it shines (`_usual_part`), what varies from point to point
    alone as its mean.
    """
    surface_emission = make_surface_emission(programs, instancing, smooth_normals)
    surface_point = make_surface(instancing, smooth_normals).point

    @wp.func
    def triangle_estimate(data: SceneData, work: EstimateWork, i: int):
        instance, primitive = work.instance[i], work.primitive[i]
        front = wp.vec3(0.0)
        back = wp.vec3(0.0)
        front_square = float(0.0)
        back_square = float(0.0)
        # counts are variables: unrolled, the loops would hold an interpreter for each point
        each = int(1)
        if work.every_point != 0:
            each = int(TRIANGLE_POINTS)
        sides = int(2)
        for k in range(work.points + 1):
            square = (float(k) + 0.5) / float(work.points)
            if k == work.points:
                square = float(0.0)
            angle = float(k) * _GOLDEN_ANGLE
            seen_front = wp.vec3(0.0)
            seen_back = wp.vec3(0.0)
            for of_direction in range(each):
                row, column = int(0), (k + of_direction) % TRIANGLE_POINTS
                if each == 1 and k == work.points:  # straight ahead from the middle
                    column = int(_ROWS + 1)
                while row + column >= _ROWS:
                    column -= _ROWS - row
                    row += 1
                place = wp.vec2(float(row) + 0.33, float(column) + 0.33) / float(_ROWS)
                normal = surface_point(data.geometry, instance, primitive, place, 0.5).geometric_normal
                across = wp.sqrt(square) * (wp.cos(angle) * tangent_of(normal) + wp.sin(angle) * bitangent_of(normal))
                ahead = wp.sqrt(1.0 - square) * normal
                for side in range(sides):
                    seen = surface_emission(data, instance, primitive, place, ahead + across, 1.0, 1, 0, 0)
                    seen = wp.max(seen, wp.vec3(0.0)) / float(each)
                    if side == 0:
                        seen_front += seen
                    else:
                        seen_back += seen
                    ahead = -ahead
            front += seen_front
            back += seen_back
            front_square += wp.length_sq(seen_front)
            back_square += wp.length_sq(seen_back)
        count = float(work.points + 1)
        if work.every_point != 0:
            front *= _usual_part(wp.length(front), front_square, count)
            back *= _usual_part(wp.length(back), back_square, count)
        work.radiance[i] = wp.min((front + back) / (2.0 * count), wp.vec3(1e30))

    return triangle_estimate
