"""Light sampling: the choice of an emitter and of a point on it, with densities.

Light that rays meet by themselves is in `hits.py`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import warp as wp

from ...scene.description import LightKind
from ...scene.features import narrow
from ...scene.geometry import Geometry
from .area_shapes import sample_area_light, sample_parallel_light
from .cells.cells import sample_cell
from .choice import ChoiceFeatures, LitPoint, make_light_choice
from .emitters import CELL
from .links import blocking_visibility, is_aimed_from, is_linked, owner_of
from .portals.portals import has_portals, sample_through_portals
from .shapes import (
    LAMP_PROGRAM,
    SURFACE_PROGRAM,
    WORLD_PROGRAM,
    LightSample,
    sample_disk_light,
    sample_sphere_light,
    sample_sun,
    spot_factor,
)
from .table import LightRecord, LightTable
from .triangles import find_triangle, sample_triangle_light, triangle_pdf
from .world import WorldDirection, sample_world

_POINT = wp.constant(int(LightKind.POINT))
_SPOT = wp.constant(int(LightKind.SPOT))
_SUN = wp.constant(int(LightKind.SUN))
_ELLIPSE = wp.constant(int(LightKind.ELLIPSE))


@dataclass(frozen=True, kw_only=True)
class LightFeatures:
    """Features that light sampling is specialised on, under the names that `SceneFeatures` has for them."""

    lights: tuple[LightKind, ...] = ()  # kinds of the scene's lights
    light_sphere: bool = False  # a POINT or SPOT shaped as a sphere
    light_choice: bool = True  # there may be several emitters
    mesh_lights: bool = False  # emissive triangles
    mesh_programs: bool = False  # emissive triangles whose radiance comes from programs
    world_light: bool = False  # the world is sampled
    lamp_programs: bool = False  # lights without mesh whose radiance comes from programs
    light_links: bool = False  # some emitters light some objects alone
    shadow_links: bool = False  # some objects alone block the light of some emitters
    light_portals: bool = False  # the world is sampled through portals
    volume_lights: bool = False  # volumes that emit are emitters
    light_bounces: bool = False  # some emitters are aimed at from the first vertices of paths alone


class Lights(NamedTuple):
    """Functions (`wp.Function`) of one specialisation. Directions are unit vectors."""

    # (table, geometry, point: LitPoint, u_choice: float, u: vec2) -> LightSample, from `point` towards one emitter
    sample: wp.Function
    # (table, geometry, instance, primitive, point: LitPoint, direction, distance) -> float: density [1/sr] with which
    # `sample` would have chosen the direction of a ray from `point` that hit this triangle; 0: it never does
    hit_pdf: wp.Function


@wp.func
def world_light(table: LightTable, found: WorldDirection) -> LightSample:
    """The world in a direction that was found."""
    s = LightSample()
    s.direction = found.direction
    s.pdf = found.pdf
    s.distance = wp.inf
    s.casts_shadow = table.world_casts_shadow
    s.visibility = table.world_visibility
    s.radiance = wp.vec3(1.0)
    s.program = WORLD_PROGRAM
    s.instance = -1
    s.primitive = -1
    return s


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


@functools.cache
def make_lights(features: LightFeatures) -> Lights:
    """The `Lights` for scenes with these features."""
    has_round = LightKind.POINT in features.lights or LightKind.SPOT in features.lights
    has_spot = LightKind.SPOT in features.lights
    has_sphere = has_round and features.light_sphere
    has_sun = LightKind.SUN in features.lights
    has_area = LightKind.RECTANGLE in features.lights or LightKind.ELLIPSE in features.lights
    choose, selection_pdf = make_light_choice(narrow(features, ChoiceFeatures))

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
    def sample(table: LightTable, geometry: Geometry, point: LitPoint, u_choice: float, u: wp.vec2) -> LightSample:
        s = LightSample()
        choice = choose(table, point, u_choice, u)
        emitter = choice.emitter
        position = point.position
        if emitter >= 0:
            if emitter < table.light_count:
                if wp.static(len(features.lights) > 0 or features.volume_lights):
                    light = table.lights[emitter]
                    s = sample_shape(light, position, u)
                    if wp.static(features.volume_lights):
                        if light.kind == wp.static(CELL):
                            s = sample_cell(light, position, u_choice, u)
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
                        if wp.static(features.light_portals):
                            if has_portals(table):
                                s = world_light(table, sample_through_portals(table, position, u))
                            else:
                                s = world_light(table, sample_world(table.world, u))
                        else:
                            s = world_light(table, sample_world(table.world, u))
            s.pdf = s.pdf * choice.pdf
            s.emitter = emitter
            if wp.static(features.light_links):
                if not is_linked(table, owner_of(table, emitter), point.receiver):
                    s.pdf = 0.0
            if wp.static(features.light_bounces):
                # scattered rays that meet the light count as if it had been found here, as in Cycles
                if not is_aimed_from(table, emitter, point.bounce):
                    s.pdf = 0.0
            if wp.static(features.shadow_links):
                s.visibility = s.visibility | blocking_visibility(table, owner_of(table, emitter))
            # beyond the range of numbers: too near or too small to count
            if not s.pdf < wp.inf:
                s.pdf = 0.0
        return s

    @wp.func
    def hit_pdf(
        table: LightTable,
        geometry: Geometry,
        instance: int,
        primitive: int,
        point: LitPoint,
        direction: wp.vec3,
        distance: float,
    ) -> float:
        if wp.static(features.mesh_lights):
            emitter = find_triangle(table, instance, primitive)
            if emitter >= 0:
                density = triangle_pdf(geometry, instance, primitive, point.position, direction, distance)
                return density * selection_pdf(table, point, emitter)
        return 0.0

    return Lights(sample, hit_pdf)
