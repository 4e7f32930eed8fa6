"""Lights without mesh that rays meet by themselves.

Lights neither block rays nor hide one another, as in Cycles: a ray gathers the light of all that it passes.
"""

from __future__ import annotations

import functools
from dataclasses import KW_ONLY, dataclass
from typing import NamedTuple

import warp as wp

from ...programs.op import NodeData
from ...scene.description import LightKind
from ...scene.features import narrow
from ...scene.program import ProgramFeatures
from .area_shapes import ERROR_SHARE_MOST, meet_area_light
from .choice import ChoiceFeatures, LitPoint, make_light_choice
from .lamp_program import make_lamp_emission
from .lights import light_weights
from .links import make_counts, make_found_by_sampling
from .met.boxes import light_of, next_met
from .shapes import LightSample, meet_disk, meet_sphere, meet_sun, spot_factor
from .table import LightRecord, LightTable

_POINT = wp.constant(int(LightKind.POINT))
_SPOT = wp.constant(int(LightKind.SPOT))
_SUN = wp.constant(int(LightKind.SUN))
_ELLIPSE = wp.constant(int(LightKind.ELLIPSE))


@dataclass(frozen=True)
class LightHitFeatures:
    """Features that the functions are compiled for, under the names that `SceneFeatures` has for them."""

    lights: tuple[LightKind, ...] = ()  # kinds of the scene's lights
    light_sphere: bool = False  # a POINT or SPOT shaped as a sphere
    light_hits: bool = False  # a light that rays can meet
    _: KW_ONLY
    light_choice: bool = True  # there may be several emitters
    mesh_lights: bool = False  # emissive triangles
    world_light: bool = False  # the world is sampled
    mis: bool = True  # False: light sampling alone finds what it can find
    lamp_program: ProgramFeatures = ProgramFeatures()
    light_links: bool = False
    shadow_links: bool = False
    light_groups: bool = False
    volume_lights: bool = False


@wp.struct
class LightHit:
    """A light that a ray meets."""

    item: int  # its place in the tree over lights; -1: the ray meets no more
    emitter: int
    distance: float  # along the ray [m], less its error
    radiance: wp.vec3  # weighted


class LightHits(NamedTuple):
    """Functions (`wp.Function`) of one specialisation.

    `nodes` are the lamps' programs; `bounce` and `passed` are inputs of these about the path. `bsdf_pdf` is the density
    of the ray's direction where it scattered last (see `mis_weight`), `visibility` the kind of ray.
    """

    # (table, nodes, point: LitPoint, direction, t_min, t_max, visibility, bsdf_pdf, bounce, passed) -> vec3: weighted
    # radiance of all lights on a ray at `t_min` <= t < `t_max` that rays of that kind see, without suns. `point` is
    # where the ray scattered last
    intersect: wp.Function
    # (table, nodes, point, direction, visibility, bsdf_pdf, bounce, passed) -> vec3: weighted radiance of the suns, for
    # a ray that leaves the scene
    miss: wp.Function
    # (the same, item: int) -> LightHit: the first of these lights after `item`, in the order of the tree, or after none
    # where it is -1; None where no light that has a place is met
    following: wp.Function | None


@functools.cache
def make_light_hits(features: LightHitFeatures) -> LightHits:
    """The `LightHits` for scenes with these features."""
    has_round = LightKind.POINT in features.lights or LightKind.SPOT in features.lights
    has_spot = LightKind.SPOT in features.lights
    has_sphere = has_round and features.light_sphere
    has_area = LightKind.RECTANGLE in features.lights or LightKind.ELLIPSE in features.lights
    met_in_space = features.light_hits and (has_round or has_area)
    met_suns = features.light_hits and LightKind.SUN in features.lights
    has_programs = bool(features.lamp_program)
    hit_weight = light_weights(features.mis)[1]
    lamp_emission = make_lamp_emission(features.lamp_program) if has_programs else None
    selection_pdf = make_light_choice(narrow(features, ChoiceFeatures)).pdf
    found_by_sampling = make_found_by_sampling(features.shadow_links)
    counts = make_counts(features.light_links, features.light_groups)

    @wp.func
    def meet_shape(light: LightRecord, origin: wp.vec3, direction: wp.vec3) -> LightSample:
        s = LightSample()
        if wp.static(has_round):
            if light.kind == _POINT or light.kind == _SPOT:
                if wp.static(has_sphere):
                    if light.sphere != 0:
                        s = meet_sphere(light, origin, direction)
                    else:
                        s = meet_disk(light, origin, direction)
                else:
                    s = meet_disk(light, origin, direction)
                s.radiance = wp.vec3(1.0)
                if wp.static(has_spot):
                    if light.kind == _SPOT and s.pdf > 0.0:
                        s.radiance = wp.vec3(spot_factor(light, origin, direction))
        if wp.static(has_area):
            if light.kind > _SUN:
                s = meet_area_light(light, origin, direction, wp.where(light.kind == _ELLIPSE, 1, 0))
        return s

    @wp.func
    def following(
        table: LightTable,
        nodes: NodeData,
        point: LitPoint,
        direction: wp.vec3,
        t_min: float,
        t_max: float,
        visibility: int,
        bsdf_pdf: float,
        bounce: int,
        passed: int,
        item: int,
    ) -> LightHit:
        hit = LightHit()
        hit.item = -1
        if (table.tree_visibility & visibility) != 0:
            origin = point.position
            reach = t_max * wp.static(1.0 + 2.0 * ERROR_SHARE_MOST)
            at = int(item)
            while hit.item < 0:
                at = next_met(table.tree, origin, direction, reach, at)
                if at < 0:
                    break
                emitter = light_of(table.tree, table.tree_leaf, at)
                light = table.lights[emitter]
                sampled = bsdf_pdf > 0.0 and found_by_sampling(table, emitter, light.visibility)
                if (light.visibility & visibility) != 0 and not sampled and counts(table, emitter, point):
                    met = meet_shape(light, origin, direction)
                    # what lies in the plane of a lamp is behind it, as for rays that are aimed at the lamp
                    t = met.distance - met.distance_error
                    if met.pdf > 0.0 and t >= t_min and t < t_max:
                        weight = float(1.0)
                        if bsdf_pdf > 0.0:
                            weight = hit_weight(bsdf_pdf, met.pdf * selection_pdf(table, point, emitter))
                        radiance = wp.cw_mul(met.radiance, light.emission)
                        if wp.static(has_programs):
                            if light.program != 0:
                                position = origin + met.distance * direction
                                emitted = lamp_emission(
                                    nodes, table, emitter, position, direction, met.distance, bounce, passed
                                )
                                radiance = wp.cw_mul(radiance, emitted)
                        hit.item = at
                        hit.emitter = emitter
                        hit.distance = t
                        hit.radiance = weight * radiance
        return hit

    @wp.func
    def intersect(
        table: LightTable,
        nodes: NodeData,
        point: LitPoint,
        direction: wp.vec3,
        t_min: float,
        t_max: float,
        visibility: int,
        bsdf_pdf: float,
        bounce: int,
        passed: int,
    ) -> wp.vec3:
        total = wp.vec3()
        if wp.static(met_in_space):
            item = int(-1)
            while True:
                hit = following(
                    table, nodes, point, direction, t_min, t_max, visibility, bsdf_pdf, bounce, passed, item
                )
                if hit.item < 0:
                    break
                total += hit.radiance
                item = hit.item
        return total

    @wp.func
    def miss(
        table: LightTable,
        nodes: NodeData,
        point: LitPoint,
        direction: wp.vec3,
        visibility: int,
        bsdf_pdf: float,
        bounce: int,
        passed: int,
    ) -> wp.vec3:
        total = wp.vec3()
        if wp.static(met_suns):
            for i in range(table.sun_count):
                emitter = table.suns[i]
                light = table.lights[emitter]
                sampled = bsdf_pdf > 0.0 and found_by_sampling(table, emitter, light.visibility)
                if (light.visibility & visibility) != 0 and not sampled and counts(table, emitter, point):
                    met = meet_sun(light, direction)
                    if met.pdf > 0.0:
                        radiance = light.emission
                        if wp.static(has_programs):
                            if light.program != 0:
                                emitted = lamp_emission(
                                    nodes, table, emitter, direction, direction, wp.inf, bounce, passed
                                )
                                radiance = wp.cw_mul(radiance, emitted)
                        weight = float(1.0)
                        if bsdf_pdf > 0.0:
                            weight = hit_weight(bsdf_pdf, met.pdf * selection_pdf(table, point, emitter))
                        total += weight * radiance
        return total

    return LightHits(intersect, miss, following if met_in_space else None)
