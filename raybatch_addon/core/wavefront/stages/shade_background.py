"""Stage: light that a ray meets outside surfaces: lights without mesh on its way, and the world behind. Then the path
ends.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...film.tile import FilmTile
from ...rays import Rays
from ...scene.description import LightKind
from ...scene.features import narrow
from ...scene.program import ProgramFeatures
from ...shading.lights.choice import ChoiceFeatures, LitPoint, make_light_choice
from ...shading.lights.hits import LightHitFeatures, make_light_hits
from ...shading.lights.lights import light_weights
from ...shading.lights.links import group_of, owner_of_world
from ...shading.lights.portals.portals import has_portals, portals_pdf
from ...shading.lights.table import LightTable
from ...shading.lights.visibility import is_lit_in_part
from ...shading.lights.world import world_pdf
from ..passes.guides import note_seen_light
from ..passes.light import add_to_group, make_add_light, shows_environment, split_light
from ..passes.record import make_record_background
from ..rays import SHADOW_PASS, Paths, Status, bounce_of, is_clear, left_point, visibility_of
from ..scene.shading_data import SceneData
from .emitted import make_world_emission
from .limits import PathLimits, clamped
from .work import TileWork

_ENDED, _INSIDE = int(Status.ENDED), int(Status.INSIDE)


@dataclass(frozen=True, kw_only=True)
class BackgroundFeatures:
    """Features that the background stage is specialised on."""

    world: bool
    film_transparent: bool
    film_glass: bool = False
    clamping: bool
    world_program: ProgramFeatures = ProgramFeatures()
    lights: tuple[LightKind, ...] = ()
    light_choice: bool = True
    mesh_lights: bool = False
    world_light: bool = False
    mis: bool = True
    subsurface: bool = False
    splits_light: bool = False
    records_surfaces: bool = False
    guides: bool = False
    catchers: bool = False
    panorama_vectors: bool = False
    light_links: bool = False
    light_groups: bool = False
    light_portals: bool = False
    volume_lights: bool = False


@functools.cache
def make_light_hits_stage(
    features: LightHitFeatures,
    *,
    transparency: bool,
    clamping: bool,
    subsurface: bool = False,
    splits_light: bool = False,
    guides: bool = False,
) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it: lights that rays met on their way."""
    intersect, miss, _ = make_light_hits(features)
    add_light = make_add_light(splits_light)

    @wp.func
    def met(
        data: SceneData, point: LitPoint, direction: wp.vec3, reach: wp.vec2, leaves: bool, paths: Paths, path: int
    ) -> wp.vec3:
        status = paths.status[path]
        visibility = visibility_of(status)
        pdf = paths.pdf[path]
        bounce = bounce_of(status)
        passed = int(0)
        if wp.static(transparency):
            passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        light = intersect(
            data.lights, data.lamp_nodes, point, direction, reach[0], reach[1], visibility, pdf, bounce + 1, passed
        )
        if leaves:
            light = light + miss(data.lights, data.lamp_nodes, point, direction, visibility, pdf, bounce + 1, passed)
        return light

    @wp.func
    def light_hits(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        direction = rays.direction[path]
        status = paths.status[path]
        if wp.static(subsurface):
            if (status & wp.static(_INSIDE)) != 0:
                return
        t_min = float(0.0)
        if wp.static(transparency):
            t_min = paths.passed_t[path]
        t_max = t_min + rays.t_max[path]
        if rays.hit_instance[path] >= 0:
            t_max = t_min + rays.hit_t[path]
        # densities are those at the last scattering, behind the transparent surfaces that were passed since
        origin = rays.origin[path] - t_min * direction
        bounce = bounce_of(status)
        point = left_point(paths, path, origin)
        light = met(data, point, direction, wp.vec2(t_min, t_max), rays.hit_instance[path] < 0, paths, path)
        light = wp.cw_mul(paths.throughput[path], light)
        if wp.static(clamping):
            light = clamped(limits, light, bounce)
        before = paths.radiance[path]
        add_light(paths, path, light, bounce, False)
        if wp.static(features.light_groups):
            for group in range(data.lights.choice[0].links.group_count):
                point.group = group
                of_group = met(data, point, direction, wp.vec2(t_min, t_max), rays.hit_instance[path] < 0, paths, path)
                of_group = wp.cw_mul(paths.throughput[path], of_group)
                if wp.static(clamping):
                    of_group = clamped(limits, of_group, bounce)
                add_to_group(paths, path, of_group, group)
        if wp.static(guides):
            note_seen_light(paths, path, before)

    return light_hits


@functools.cache
def make_background(features: BackgroundFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it: rays that leave the scene."""
    has_program = bool(features.world_program)
    world_emission = make_world_emission(features.world_program) if has_program else None
    hit_weight = light_weights(features.mis)[1]
    selection_pdf = make_light_choice(narrow(features, ChoiceFeatures)).pdf
    portals = features.light_portals
    record_background = None
    if features.records_surfaces:
        record_background = make_record_background(features.catchers, features.panorama_vectors)

    @wp.func
    def density(lights: LightTable, point: LitPoint, direction: wp.vec3) -> float:
        """With which the world is sampled."""
        if wp.static(portals):
            if has_portals(lights):
                return portals_pdf(lights, point.position, direction)
        return world_pdf(lights.world, direction)

    @wp.func
    def background(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        status = paths.status[path]
        if wp.static(features.subsurface):
            if (status & wp.static(_INSIDE)) != 0:
                return  # a step of a walk that met nothing
        bounce = bounce_of(status)
        throughput = paths.throughput[path]
        shows_world = bool(True)
        if wp.static(features.film_transparent):
            shows_film = bounce == 0
            if wp.static(features.film_glass):
                shows_film = is_clear(paths, path, bounce)
            if shows_film and paths.alpha.shape[0] > 0:
                shows_world = False
                paths.alpha[path] = paths.alpha[path] - (throughput[0] + throughput[1] + throughput[2]) / 3.0
        if wp.static(features.world):
            shines = shows_world
            if wp.static(features.splits_light and features.film_transparent):
                shines = shows_world or shows_environment(paths)  # the pass has what a transparent film leaves out
            if shines and (data.world_visibility & visibility_of(status)) != 0:
                light = wp.cw_mul(throughput, data.world)
                if wp.static(has_program):
                    if data.world_nodes.program_first.shape[0] > 0:
                        passed = int(0)
                        if paths.passed.shape[0] > 0:
                            passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
                        direction = rays.direction[path]
                        light = wp.cw_mul(
                            throughput,
                            world_emission(data, rays.origin[path], direction, visibility_of(status), bounce, passed),
                        )
                        if wp.static(features.world_light):
                            pdf = paths.pdf[path]
                            if pdf > 0.0 and data.lights.world_emitter >= 0:
                                if is_lit_in_part(data.lights.world_visibility):
                                    light = wp.vec3(0.0)  # found by light sampling alone
                                else:
                                    origin = rays.origin[path]
                                    if paths.passed_t.shape[0] > 0:
                                        origin = origin - paths.passed_t[path] * direction
                                    point = left_point(paths, path, origin)
                                    chosen = selection_pdf(data.lights, point, data.lights.world_emitter)
                                    light = hit_weight(pdf, chosen * density(data.lights, point, direction)) * light
                if wp.static(features.clamping):
                    light = clamped(limits, light, bounce)
                if shows_world:
                    before = paths.radiance[path]
                    paths.radiance[path] = before + light
                    if wp.static(features.light_groups):
                        add_to_group(paths, path, light, group_of(data.lights, owner_of_world(data.lights)))
                    if wp.static(features.guides):
                        note_seen_light(paths, path, before)
                if wp.static(features.splits_light):
                    if paths.passes.shape[0] > 0:
                        split_light(paths, path, light, bounce, False, paths.passes[0].environment)
        if wp.static(features.records_surfaces):
            if bounce == 0 and paths.passes.shape[0] > 0:
                record_background(work, paths, film, path, rays.direction[path])
        paths.status[path] = status | wp.static(_ENDED)

    return background
