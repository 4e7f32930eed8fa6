"""The brightness of lamps whose emission a program computes, for the choice among emitters."""

from __future__ import annotations

import functools

import warp as wp

from ...scene.description import LightKind
from ...scene.program import ProgramFeatures
from ...shading.lights.lamp_program import make_lamp_emission
from ...shading.lights.table import LightRecord
from ...shading.sampling import bitangent_of, sample_cone, sample_sphere, tangent_of, to_world
from ..scene.shading_data import SceneData
from .work import EstimateWork

# Distances at which the points are looked at, in turn: the scene's radius, its half, its quarter, ...
_REACHES = 3
# Fractions that make points of two and of four dimensions (Roberts 2018, "The Unreasonable Effectiveness of
# Quasirandom Sequences")
_STEPS = wp.constant(wp.vec4(0.85667488, 0.73389185, 0.62870672, 0.53859725))

_SPOT = wp.constant(int(LightKind.SPOT))
_SUN = wp.constant(int(LightKind.SUN))
_ELLIPSE = wp.constant(int(LightKind.ELLIPSE))
# Half the angle of the cone around its axis in which an area light is looked at, where it shines as a Lambertian does
_LAMBERTIAN = wp.constant(0.7)  # 1 - cos


@wp.func
def _fraction(k: int, dimension: int) -> float:
    x = (float(k) + 0.5) * _STEPS[dimension]
    return x - wp.floor(x)


@wp.func
def outward(light: LightRecord, u: wp.vec2) -> wp.vec3:
    """A direction in which a lamp shines."""
    spread = float(0.0)  # 1 - cos of half the cone's angle
    if light.kind == _SPOT:
        spread = 1.0 - light.cos_half
    elif light.kind == _SUN:
        spread = light.one_minus_cos
    elif light.kind > _SUN:
        if light.delta == 0:
            spread = _LAMBERTIAN
            if light.spread_scale > 0.0:
                tangent = light.tan_half_spread
                spread = wp.min(spread, 1.0 - 1.0 / wp.sqrt(1.0 + tangent * tangent))
    else:
        return sample_sphere(u)
    return to_world(sample_cone(u, spread), tangent_of(light.axis), bitangent_of(light.axis), light.axis)


@functools.cache
def make_lamp_estimate(programs: ProgramFeatures) -> wp.Function:
    """Function (data, work, i: int): mean brightness of lamp `i` over `points` points."""
    lamp_emission = make_lamp_emission(programs)

    @wp.func
    def lamp_estimate(data: SceneData, work: EstimateWork, i: int):
        lamp = work.lamps[i]
        light = work.lights.lights[lamp]
        total = wp.float64(0.0)
        for k in range(work.points):  # a variable: unrolled, the loop would hold an interpreter for each point
            away = outward(light, wp.vec2(_fraction(k, 0), _fraction(k, 1)))
            position = light.position + light.radius * away
            if light.kind > _SUN:
                x = 2.0 * _fraction(k, 2) - 1.0
                y = 2.0 * _fraction(k, 3) - 1.0
                if light.kind == _ELLIPSE:
                    y = y * wp.sqrt(1.0 - x * x)
                position = light.position + x * light.half_x * light.axis_x + y * light.half_y * light.axis_y
            distance = work.scene_radius / float(1 << (k % wp.static(_REACHES)))
            radiance = lamp_emission(data.lamp_nodes, work.lights, lamp, position, -away, distance, 1, 0)
            total += wp.float64((radiance[0] + radiance[1] + radiance[2]) / 3.0)
        work.brightness[i] = total / wp.float64(work.points)

    return lamp_estimate
