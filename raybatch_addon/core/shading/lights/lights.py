"""Light sampling: the choice of an emitter and of a point on it, with densities.

Light that rays meet by themselves is in `light_hits.py`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import warp as wp

from ...scene.description import LightKind, Visibility
from ...scene.geometry import Geometry, corners_of, triangle_vertices
from ..sampling import sample_triangle
from .area_shapes import sample_area_light, sample_parallel_light
from .light_choice import choice_bits, choose_emitter, selection_pdf
from .light_shapes import (
    GAMMA_8,
    LAMP_PROGRAM,
    SURFACE_PROGRAM,
    WORLD_PROGRAM,
    LightSample,
    sample_disk_light,
    sample_sphere_light,
    sample_sun,
    spot_factor,
)
from .light_table import LightRecord, LightTable
from .world import sample_world, world_pdf

_POINT = wp.constant(int(LightKind.POINT))
_SPOT = wp.constant(int(LightKind.SPOT))
_SUN = wp.constant(int(LightKind.SUN))
_ELLIPSE = wp.constant(int(LightKind.ELLIPSE))
_SCATTERED = wp.constant(int(Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.TRANSMISSION))


@dataclass(frozen=True)
class LightFeatures:
    """Features that light sampling is specialised on, under the names that `SceneFeatures` has for them."""

    lights: tuple[LightKind, ...] = ()  # kinds of the scene's lights
    light_sphere: bool = False  # a POINT or SPOT shaped as a sphere
    mesh_lights: bool = False  # emissive triangles
    mesh_programs: bool = False  # emissive triangles whose radiance comes from programs
    world_light: bool = False  # the world is sampled
    lamp_programs: bool = False  # lights without mesh whose radiance comes from programs


class Lights(NamedTuple):
    """Functions (`wp.Function`) of one specialisation. Directions are unit vectors."""

    # (table, geometry, position, u_choice: float, u: vec2) -> LightSample, from `position` towards one emitter
    sample: wp.Function
    # (table, geometry, instance, primitive, direction, distance) -> float: density [1/sr] with which `sample` would
    # have chosen the direction of a ray that hit this triangle; 0: it never does
    hit_pdf: wp.Function


@wp.func
def sample_world_light(table: LightTable, u: wp.vec2) -> LightSample:
    """A direction into the world."""
    s = LightSample()
    found = sample_world(table.world, u)
    s.direction = found.direction
    s.pdf = found.pdf
    s.distance = wp.inf
    s.casts_shadow = 1
    s.visibility = table.world_visibility
    s.radiance = wp.vec3(1.0)
    s.program = WORLD_PROGRAM
    s.instance = -1
    s.primitive = -1
    return s


@wp.func
def world_light_pdf(table: LightTable, direction: wp.vec3) -> float:
    """Density with which light sampling would have chosen `direction` into the world [1/sr]."""
    return world_pdf(table.world, direction) * selection_pdf(table, table.world_emitter)


@wp.func
def power_heuristic(pdf: float, other: float) -> float:
    """Weight of a sample of density `pdf` that could also have come from the strategy of density `other`.

    Power heuristic with beta 2 (Veach 1997, section 9.2.4).
    """
    if other <= 0.0:
        return 1.0
    ratio = other / pdf
    return 1.0 / (1.0 + ratio * ratio)


@wp.func
def mis_weight(bsdf_pdf: float, light_pdf: float) -> float:
    """Weight of light that a scattered ray meets.

    `bsdf_pdf` = 0: light sampling could not find the light (camera rays and delta lobes), or does not take part.
    """
    if bsdf_pdf <= 0.0:
        return 1.0
    return power_heuristic(bsdf_pdf, light_pdf)


@wp.func
def full_weight(pdf: float, other: float) -> float:
    """Weight of a sampled light without multiple importance sampling: light sampling alone finds it."""
    return 1.0


@wp.func
def left_weight(bsdf_pdf: float, light_pdf: float) -> float:
    """Weight of light that a scattered ray meets without multiple importance sampling: 0 if light sampling finds it."""
    return wp.where(bsdf_pdf > 0.0 and light_pdf > 0.0, 0.0, 1.0)


def light_weights(mis: bool) -> tuple[wp.Function, wp.Function]:
    """Two functions of weights, with or without multiple importance sampling.

    The first weighs light that was sampled (light_pdf, bsdf_pdf), the second light that a scattered ray met (bsdf_pdf,
    light_pdf).
    """
    return (power_heuristic, mis_weight) if mis else (full_weight, left_weight)


@wp.func
def is_lit_in_part(visibility: int) -> bool:
    """Whether a light is seen by some kinds of scattered rays but not by all.

    Such lights are left to light sampling, which knows the kinds of lobes apart; a scattered ray stands for all of
    them.
    """
    kinds = visibility & _SCATTERED
    return kinds != 0 and kinds != _SCATTERED


@wp.func
def find_triangle(table: LightTable, instance: int, primitive: int) -> int:
    """Number of the emitter that is this triangle of an instance, or -1."""
    if table.instance_first.shape[0] == 0:  # all emission comes from programs
        return -1
    low = table.instance_first[instance]
    end = table.instance_first[instance + 1]
    high = end
    while low < high:
        middle = low + (high - low) // 2
        if table.triangle_primitive[middle] < primitive:
            low = middle + 1
        else:
            high = middle
    if low < end:
        if table.triangle_primitive[low] == primitive:
            return table.light_count + low
    return -1


@wp.func
def triangle_density(normal: wp.vec3, direction: wp.vec3, distance: float) -> float:
    """Density per solid angle of uniform points on a triangle [1/sr]; the length of `normal` is twice the area.

    It is 0 for a triangle that is seen edge-on, or so nearly that the density is beyond the range of numbers.
    """
    projected = 0.5 * wp.abs(wp.dot(normal, direction))
    density = distance * distance / projected
    return wp.where(density < wp.inf, density, 0.0)


@wp.func
def triangle_distance_error(
    geometry: Geometry, instance: int, primitive: int, normal: wp.vec3, direction: wp.vec3, distance: float
) -> float:
    """Bound of how much nearer than `distance` a ray along `direction` may find the triangle that it aims at [m].

    Rounding moves the plane of the triangle, or the ray, by at most `error` along each axis; the slant of the ray
    stretches the part along the normal.
    """
    triangle = corners_of(geometry, geometry.mesh_triangle_first[geometry.instance_mesh[instance]] + primitive)
    p0 = wp.abs(geometry.positions[triangle[0]])
    p1 = wp.abs(geometry.positions[triangle[1]])
    p2 = wp.abs(geometry.positions[triangle[2]])
    m = geometry.instance_transform[instance]
    largest = wp.max(p0, wp.max(p1, p2))
    # terms of the corners in world space; the shaded point is at most `distance` away, and so are the products of the
    # ray with its distance
    error = wp.vec3(distance)
    for i in range(3):
        reach = wp.abs(m[i, 0]) * largest[0] + wp.abs(m[i, 1]) * largest[1] + wp.abs(m[i, 2]) * largest[2]
        error[i] = error[i] + reach + wp.abs(m[i, 3])
    slant = wp.abs(wp.dot(normal, direction))
    # each of four steps: the corners to the world, the sampled point, the ray to the object, the ray's test
    return wp.static(4.0 * GAMMA_8) * wp.dot(wp.abs(normal), error) / slant


@wp.func
def sample_triangle_light(
    table: LightTable, geometry: Geometry, triangle: int, position: wp.vec3, u: wp.vec2
) -> LightSample:
    """A direction towards a uniform point of an emissive triangle."""
    s = LightSample()
    s.instance = table.triangle_instance[triangle]
    s.primitive = table.triangle_primitive[triangle]
    a, b, c = triangle_vertices(geometry, s.instance, s.primitive)
    weight = sample_triangle(u)
    # corners relative to the shaded point, so that far coordinates cancel once only
    offset = weight[0] * (a - position) + weight[1] * (b - position) + weight[2] * (c - position)
    s.distance = wp.length(offset)
    s.casts_shadow = 1
    s.visibility = table.instance_visibility[s.instance]
    if s.distance > 0.0:
        s.direction = offset / s.distance
        s.radiance = table.triangle_radiance[triangle]
        s.barycentric = wp.vec2(weight[1], weight[2])
        normal = wp.cross(b - a, c - a)
        s.pdf = triangle_density(normal, s.direction, s.distance)
        if s.pdf > 0.0:
            s.distance_error = triangle_distance_error(
                geometry, s.instance, s.primitive, normal, s.direction, s.distance
            )
    return s


@functools.cache
def make_lights(features: LightFeatures) -> Lights:
    """The `Lights` for scenes with these features."""
    has_round = LightKind.POINT in features.lights or LightKind.SPOT in features.lights
    has_spot = LightKind.SPOT in features.lights
    has_sphere = has_round and features.light_sphere
    has_sun = LightKind.SUN in features.lights
    has_area = LightKind.RECTANGLE in features.lights or LightKind.ELLIPSE in features.lights

    @wp.func
    def sample_shape(light: LightRecord, position: wp.vec3, u: wp.vec2) -> LightSample:
        s = LightSample()
        if wp.static(has_round):
            if light.kind == _POINT or light.kind == _SPOT:
                factor = float(1.0)
                if light.delta != 0:
                    offset = light.position - position
                    s.distance = wp.length(offset)
                    square = s.distance * s.distance
                    if square > 0.0:
                        s.direction = offset / s.distance
                        s.pdf = 1.0
                        factor = 1.0 / square
                else:
                    if wp.static(has_sphere):
                        if light.sphere != 0:
                            s = sample_sphere_light(light, position, u)
                        else:
                            s = sample_disk_light(light, position, u)
                    else:
                        s = sample_disk_light(light, position, u)
                if wp.static(has_spot):
                    if light.kind == _SPOT and s.pdf > 0.0:
                        factor = factor * spot_factor(light, position, s.direction)
                s.radiance = wp.vec3(factor)
        if wp.static(has_sun):
            if light.kind == _SUN:
                if light.delta != 0:
                    s.direction = -light.axis
                    s.distance = wp.inf
                    s.pdf = 1.0
                else:
                    s = sample_sun(light, u)
                s.radiance = wp.vec3(1.0)
        if wp.static(has_area):
            if light.kind > _SUN:
                ellipse = wp.where(light.kind == _ELLIPSE, 1, 0)
                if light.delta != 0:
                    s = sample_parallel_light(light, position, ellipse)
                    s.radiance = wp.vec3(1.0)
                else:
                    s = sample_area_light(light, position, u, ellipse)
        return s

    @wp.func
    def sample(table: LightTable, geometry: Geometry, position: wp.vec3, u_choice: float, u: wp.vec2) -> LightSample:
        s = LightSample()
        if table.emitter_count > 0:
            emitter = choose_emitter(table, choice_bits(u_choice, u))
            if emitter < table.light_count:
                if wp.static(len(features.lights) > 0):
                    light = table.lights[emitter]
                    s = sample_shape(light, position, u)
                    s.radiance = wp.cw_mul(s.radiance, light.emission)
                    s.delta = light.delta
                    s.casts_shadow = light.casts_shadow
                    s.visibility = light.visibility
                    s.instance = -1
                    s.primitive = -1
                    if wp.static(features.lamp_programs):
                        if light.program != 0:
                            s.instance = emitter
                            s.program = LAMP_PROGRAM
            else:
                if wp.static(features.mesh_lights):
                    if emitter != table.world_emitter:
                        s = sample_triangle_light(table, geometry, emitter - table.light_count, position, u)
                        if wp.static(features.mesh_programs):
                            if table.triangle_program.shape[0] > 0:
                                if table.triangle_program[emitter - table.light_count] != 0:
                                    s.radiance = wp.vec3(1.0)
                                    s.program = SURFACE_PROGRAM
                if wp.static(features.world_light):
                    if emitter == table.world_emitter:
                        s = sample_world_light(table, u)
            s.pdf = s.pdf * selection_pdf(table, emitter)
            # beyond the range of numbers: too near or too small to count
            if not s.pdf < wp.inf:
                s.pdf = 0.0
        return s

    @wp.func
    def hit_pdf(
        table: LightTable, geometry: Geometry, instance: int, primitive: int, direction: wp.vec3, distance: float
    ) -> float:
        if wp.static(features.mesh_lights):
            emitter = find_triangle(table, instance, primitive)
            if emitter >= 0:
                a, b, c = triangle_vertices(geometry, instance, primitive)
                return triangle_density(wp.cross(b - a, c - a), direction, distance) * selection_pdf(table, emitter)
        return 0.0

    return Lights(sample, hit_pdf)
