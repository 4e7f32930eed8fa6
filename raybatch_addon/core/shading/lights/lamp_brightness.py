"""Estimated brightness of lamps whose emission a program computes, for the choice among emitters."""

import functools

import numpy as np
import warp as wp

from ...device.devices import load_module
from ...device.kernel import kernel_options
from ...programs.op import NodeData
from ...scene.description import LightKind, Scene
from ...scene.program import ProgramFeatures
from ..sampling import bitangent_of, sample_cone, sample_sphere, tangent_of, to_world
from .emitters import scene_radius
from .lamp_program import make_lamp_emission
from .light_table import LightRecord, LightTable

# Points of each lamp, of which the mean counts
_POINTS = 96
# Distances at which the points are looked at, in turn: the scene's radius, its half, its quarter, ...
_REACHES = 3
# Brightness of a program that was black at all points: it may shine elsewhere
_UNSEEN = 0.01
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
def lamp_brightness_kernel(programs: ProgramFeatures) -> wp.Kernel:
    """Kernel (nodes, table, lamps, radius, points, brightness): mean brightness of each lamp over `points` points.

    `lamps` holds numbers of lights with a program, `brightness` the results, both of shape [n]; `radius` is that of the
    scene [m].
    """
    lamp_emission = make_lamp_emission(programs)

    @wp.kernel(**kernel_options(programs.apart))
    def lamp_brightness(
        nodes: NodeData,
        table: LightTable,
        lamps: wp.array(dtype=int),
        radius: float,
        points: int,
        brightness: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        lamp = lamps[i]
        light = table.lights[lamp]
        total = wp.float64(0.0)
        for k in range(points):  # `points` is a variable: unrolled, the loop would hold an interpreter for each point
            away = outward(light, wp.vec2(_fraction(k, 0), _fraction(k, 1)))
            position = light.position + light.radius * away
            if light.kind > _SUN:
                x = 2.0 * _fraction(k, 2) - 1.0
                y = 2.0 * _fraction(k, 3) - 1.0
                if light.kind == _ELLIPSE:
                    y = y * wp.sqrt(1.0 - x * x)
                position = light.position + x * light.half_x * light.axis_x + y * light.half_y * light.axis_y
            distance = radius / float(1 << (k % wp.static(_REACHES)))
            radiance = lamp_emission(nodes, table, lamp, position, -away, distance, 1, 0)
            total += wp.float64((radiance[0] + radiance[1] + radiance[2]) / 3.0)
        brightness[i] = total / wp.float64(points)

    return lamp_brightness


def brightness_of_lamps(
    scene: Scene, nodes: NodeData, features: ProgramFeatures, device: wp.Device, table: LightTable
) -> np.ndarray:
    """Estimated factor by which programs change the brightness of each light of `scene`; float64, shape [n].

    It is 1 for a light without program, and 0 for a program that never shines and for no other.
    """
    result = np.ones(len(scene.lights))
    lamps = np.array([i for i, light in enumerate(scene.lights) if light.program is not None], np.int32)
    if not len(lamps):
        return result
    brightness = wp.zeros(len(lamps), dtype=wp.float64, device=device)
    inputs = [nodes, table, wp.array(lamps, dtype=int, device=device), scene_radius(scene), _POINTS, brightness]
    kernel = lamp_brightness_kernel(features)
    load_module(kernel, device)
    wp.launch(kernel, len(lamps), inputs, device=device)
    for i, mean in zip(lamps, brightness.numpy()):
        shines = any(step.op == "emission" for step in scene.lights[i].program.instructions)
        result[i] = (mean if mean > 0 else _UNSEEN) if shines else 0.0
    return result
