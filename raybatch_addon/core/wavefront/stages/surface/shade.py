"""Stage: a ray has met a surface. It emits, the light that is aimed at shines on it, and the path scatters. Next:
`trace`, or `accumulate`.
"""

from __future__ import annotations

import functools

import warp as wp

from ....device.codegen.local_arrays import Unset
from ....film.tile import FilmTile
from ....rays import Rays
from ....scene.description import ClosureKind, Visibility
from ....scene.features import narrow
from ....scene.passes import shows_colors
from ....shading.bsdf.bsdf import (
    DELTA,
    DIFFUSE,
    LOBE_FLOATS,
    SUBSURFACE,
    TRANSMISSION,
    TRANSPARENT,
    BsdfValue,
    ClosureFeatures,
    Lobe,
    make_bsdf,
)
from ....shading.bsdf.materials import (
    AOV,
    RECORD_FLOATS,
    SURFACE_NORMAL,
    ClosureRecord,
    address_of,
    address_of_closure,
    new_closure,
)
from ....shading.lights.lights import LightFeatures, light_weights, make_lights
from ....shading.lights.shapes import LightSample
from ....shading.sampling import bitangent_of, tangent_of
from ....shading.sequences.keys import BSDF, ROULETTE, TEXTURE
from ....shading.sequences.sampler import make_sampler
from ....shading.surface import spawn_origin
from ...passes.colors import ClosuresInView
from ...passes.guides import make_note_surface, note_seen_light
from ...passes.light import divide_extending_ray
from ...passes.record import make_record_surface, record_aov, settles
from ...rays import (
    BOUNCE_SHIFT,
    SHADOW_PASS,
    VISIBILITY_SHIFT,
    Paths,
    Status,
    is_clear,
    note_density,
    note_receiver,
    visibility_of,
)
from ...scene.shading_data import SceneData, depth_of
from ..limits import PathLimits, has_light, survival_of
from ..walk import make_walk_begin
from ..work import TileWork
from .aim import AimFeatures, aimed_light, is_aimed, make_choose_light
from .answered import make_answered_program
from .caustics import make_leave_out_caustics
from .changed import make_change
from .clear import make_note_clear
from .cone import cone_width, make_filtered_program, make_scattered_cone, path_cone
from .connect_light import make_connect_light
from .emission import make_gather_emission
from .features import SurfaceFeatures
from .history import history_after
from .lift import make_lit_frame
from .portal import pass_portal
from .program import fixed_closure_count, fixed_closures, make_surface_program, program_of, shading_point
from .vertex import VertexFeatures, make_vertex

_RAY_NEW = int(Status.RAY_NEW)
_STRAIGHT = int(Status.STRAIGHT)
_ENDED = int(Status.ENDED)
_INSIDE = int(Status.INSIDE)


@functools.cache
def make_shade_surface(features: SurfaceFeatures, aims: AimFeatures | None) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it. `aims`: what the stage `aim` is specialised on, where it is a
    part of this one; None where it is a kernel of its own, launched before.
    """
    choose_light = make_choose_light(aims) if aims else None
    sampler = make_sampler(features.sample_sequence)
    sample_1d, sample_3d = sampler.sample_1d, sampler.sample_3d
    vertex = make_vertex(narrow(features, VertexFeatures))
    kinds = ClosureFeatures(features.closures, features.half_glass)
    bsdf = make_bsdf(kinds)
    look, propose, mix, value, complete = bsdf.look, bsdf.propose, bsdf.mix, bsdf.value, bsdf.complete
    bsdf_holdout = bsdf.holdout
    lights = make_lights(narrow(features, LightFeatures))
    gather_emission = make_gather_emission(bsdf.emission, lights.hit_pdf, light_weights(features.mis)[1], features)
    connect_light, lit_frame = make_connect_light(features), make_lit_frame(features.terminator)
    programs = features.programs
    run_surface = make_surface_program(programs)
    run_filtered = make_filtered_program(programs)
    run_answered = make_answered_program(programs)
    scattered_cone = make_scattered_cone(features.smooth_normals)
    begin_walk = make_walk_begin(features.sample_sequence)
    lobes_most = features.lobes_most
    note_surface = make_note_surface(kinds) if features.guides else None
    record_surface = None
    if features.records_surfaces:
        colors = shows_colors(features.passes)
        record_surface = make_record_surface(
            kinds, features.transparency, colors, features.catchers, features.panorama_vectors
        )
    change = make_change(kinds, features.filter_glossy)
    note_clear = make_note_clear(kinds)
    leave_out_caustics = make_leave_out_caustics(kinds, features.caustics_reflective, features.caustics_refractive)

    @wp.func
    def shade_surface(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        v = vertex(data, work, limits, paths, rays, path)
        if not v.there:
            return
        status = v.status
        surface = v.surface
        frame = v.frame
        wo = v.wo
        hit_t = rays.hit_t[path]
        passed_t = float(0.0)
        if wp.static(features.transparency):
            passed_t = paths.passed_t[path]
        if wp.static(bool(programs)):
            address = fixed_closures(data, surface.material)
            first = int(0)
            end = int(0)
            program = program_of(data, surface.material)
            if program >= 0:
                point = shading_point(
                    surface, wo, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], passed_t + hit_t
                )
                point.ray_kind = visibility_of(status)
                point.bounce = v.bounce
                point.passed = v.passed
                if wp.static(features.path_history):
                    point.history = paths.history[path]
                records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
                if wp.static(features.texture_levels):
                    width = cone_width(path_cone(data.nodes, paths, path, v.bounce), point.ray_length)
                    chance = sample_1d(v.key, v.pixel.sample, v.dimension + wp.uint32(TEXTURE))
                if wp.static(programs.answer_count > 0 and not features.texture_levels):
                    width = float(0.0)
                    chance = float(0.0)
                if wp.static(programs.answer_count > 0):
                    end = run_answered(data, paths, path, program, point, records, width, chance)
                elif wp.static(features.texture_levels):
                    end = run_filtered(data, program, point, records, width, chance)
                else:
                    end = run_surface(data, program, point, records)
                address = address_of(records)
            else:
                end = fixed_closure_count(data, surface.material)
            made = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
            if wp.static("surface_normal" in programs.ops):
                if end > 0 and made[0].kind == wp.static(SURFACE_NORMAL):
                    first = 1
                    frame.normal = made[0].normal
                    frame.tangent = tangent_of(frame.normal)
                    frame.bitangent = bitangent_of(frame.normal)
            if wp.static("aov" in programs.ops):
                while first < end and made[first].kind == wp.static(AOV):
                    if wp.static(features.records_surfaces):
                        if v.bounce == 0 and not v.comes_out:
                            record_aov(paths, path, v.passed, made[first].distribution, made[first].weight)
                    first += 1
            if wp.static(features.subsurface):
                if v.comes_out:  # Lambert's law, about the medium's own normal
                    white = new_closure(wp.static(int(ClosureKind.DIFFUSE)), wp.vec3(1.0))
                    for c in range(first, end):
                        if made[c].kind == wp.static(int(ClosureKind.SUBSURFACE)):
                            white.normal = made[c].normal
                    one = wp.zeros(wp.static(RECORD_FLOATS), dtype=Unset)
                    whites = wp.array(ptr=address_of(one), shape=(1,), dtype=ClosureRecord)
                    whites[0] = white
                    address = address_of(one)
                    first = 0
                    end = 1
            closures = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        else:
            closures = data.materials.closures
            first = int(data.materials.records[surface.material].closure_first)
            end = int(data.materials.records[surface.material].closure_end)
            if wp.static(features.subsurface):
                if v.comes_out:  # a white closure lies behind those of the materials
                    end = closures.shape[0]
                    first = end - 1

        shows_first = v.bounce == 0 and v.passed == 0 and not v.comes_out
        if wp.static(features.records_surfaces and features.transparency):
            # else `record_surface` decides which surface is shown
            shows_first = shows_first and not settles(paths)
        if shows_first:
            if wp.static("Normal" in features.passes):
                if paths.normal.shape[0] > 0:
                    paths.normal[path] = frame.normal
            if v.pixel.sample == wp.uint32(0):
                if wp.static("Depth" in features.passes):
                    if film.depth.shape[0] > 0:
                        film.depth[v.pixel.index] = depth_of(data, surface.position)
                if wp.static("Position" in features.passes):
                    if film.position.shape[0] > 0:
                        film.position[v.pixel.index] = surface.position

        if wp.static(features.film_holes):
            shows_film = v.bounce == 0
            if wp.static(features.film_glass):
                shows_film = is_clear(paths, path, v.bounce)
            if shows_film and paths.alpha.shape[0] > 0:
                carried = paths.throughput[path]
                seen = (carried[0] + carried[1] + carried[2]) / 3.0
                paths.alpha[path] = paths.alpha[path] - seen * bsdf_holdout(closures, first, end)

        if wp.static(features.emission):
            before = paths.radiance[path]
            gather_emission(data, limits, paths, rays, path, closures, first, end, passed_t)
            if wp.static(features.guides):
                note_seen_light(paths, path, before)

        # at its last surface a path scatters no more, but still passes what is transparent, as shadow rays do
        if wp.static(not (features.transparency or features.guides)):
            if v.last:
                paths.status[path] = status | wp.static(_ENDED)
                return

        of_lobes = wp.zeros(wp.static(lobes_most * LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(of_lobes), shape=(wp.static(lobes_most),), dtype=Lobe)
        look(closures, first, end, data.materials.albedo, frame, wo, lobes)
        if wp.static(features.guides or features.records_surfaces):
            view = ClosuresInView()
            view.closures = closures
            view.first = first
            view.end = end
            view.lobes = lobes
            view.frame = frame
        if wp.static(features.guides):
            note_surface(paths, path, view, data.materials.albedo, hit_t)
        if wp.static(features.records_surfaces):
            if v.bounce == 0 and not v.comes_out and paths.passes.shape[0] > 0:
                record_surface(data, paths, rays, film, path, v, view)
        if wp.static(features.lacks_caustics):
            leave_out_caustics(limits, closures, first, end, lobes, visibility_of(status))
        if wp.static(features.changes_closures):  # colours are those of the facets as they are
            of_own = wp.zeros(wp.static(lobes_most * RECORD_FLOATS), dtype=Unset)
            own = wp.array(ptr=address_of(of_own), shape=(wp.static(lobes_most),), dtype=ClosureRecord)
            where = address_of_closure(closures, 0)
            if change(limits, paths, path, status, v.bounce, closures, first, end, own):
                where = address_of(of_own)
                end = end - first
                first = 0
            closures = wp.array(ptr=where, shape=(wp.max(lobes_most, closures.shape[0]),), dtype=ClosureRecord)
        u = sample_3d(v.key, v.pixel.sample, v.dimension + wp.uint32(BSDF))
        scattered = propose(closures, first, end, lobes, data.materials.albedo, frame, wo, u[2], wp.vec2(u[0], u[1]))
        # The direction of the light, then that of the path. A loop, so that the code of the closures is there once: a
        # GPU waits for instructions more than for anything else here.
        light = LightSample()
        if wp.static(features.shadow_rays):
            if is_aimed(data.lights, limits, v):
                if wp.static(aims is not None):
                    light = choose_light(data, paths, path, v)
                else:
                    light = aimed_light(paths, rays, path)
                    if wp.static(features.shadow_links):
                        light.visibility = rays.visibility[paths.status.shape[0] + path]
        if wp.static(features.splits_light):
            first_value = BsdfValue()  # in the direction of the path
        turn = int(0)
        while turn < 2:
            wi = light.direction
            wanted = light.pdf > 0.0
            if turn == 1:
                wi = scattered.direction
                wanted = scattered.lobe != 0 and (scattered.lobe & DELTA) == 0
            if wanted:
                about = lit_frame(data, rays, path, frame, wi, turn)
                mixture = mix(closures, first, end, lobes, data.materials.albedo, about, wo, wi)
                if turn == 1:
                    scattered = complete(scattered, mixture)
                    if wp.static(features.splits_light):
                        first_value = value(mixture)
                else:
                    if wp.static(features.shadow_rays):
                        status = status | connect_light(data, limits, paths, rays, path, v, light, value(mixture))
            turn += 1
        if wp.static(features.splits_light):
            if paths.passes.shape[0] > 0 and v.bounce == 0 and (scattered.lobe & (TRANSPARENT | SUBSURFACE)) == 0:
                reflected = wp.dot(scattered.direction, frame.geometric_normal) > 0.0
                divide_extending_ray(paths, path, first_value.value, first_value.diffuse, scattered.lobe, reflected)
        throughput = wp.cw_mul(paths.throughput[path], scattered.weight)
        goes_on = has_light(throughput) and (not v.last or (scattered.lobe & TRANSPARENT) != 0)

        if wp.static(features.transparency):
            if (scattered.lobe & TRANSPARENT) != 0:
                # the path goes straight on: it remembers where it last scattered, and how
                goes_on = goes_on and v.passed < limits.transparent_bounce_max
                paths.passed[path] = v.passed + 1 + v.passed * wp.static(SHADOW_PASS)
                paths.passed_t[path] = passed_t + hit_t
                status = status | wp.static(_STRAIGHT)
            else:
                paths.passed[path] = v.passed + v.passed * wp.static(SHADOW_PASS)
                paths.passed_t[path] = 0.0
        if wp.static(features.path_history):
            if wp.static(features.shadow_rays):
                paths.shadow_history[path] = paths.history[path]
            if (scattered.lobe & (TRANSPARENT | SUBSURFACE)) == 0:
                paths.history[path] = history_after(paths.history[path], scattered.lobe)
        if (scattered.lobe & (TRANSPARENT | SUBSURFACE)) == 0:
            pdf = scattered.pdf
            if (scattered.lobe & DELTA) != 0 or v.pixel.x >= limits.nee_end:
                pdf = 0.0
            paths.pdf[path] = pdf
            if wp.static(features.least_density):
                density = float(scattered.pdf)
                if (scattered.lobe & DELTA) != 0:
                    density = wp.inf
                note_density(paths, path, v.bounce, density)
            if wp.static(features.texture_levels):
                paths.cone[path] = scattered_cone(
                    data.geometry,
                    v,
                    path_cone(data.nodes, paths, path, v.bounce),
                    rays.hit_instance[path],
                    rays.hit_primitive[path],
                    passed_t + hit_t,
                    scattered.lobe,
                    scattered.pdf,
                )
            if wp.static(features.shadow_rays and features.light_choice):
                paths.side[path] = v.side
            if wp.static(features.light_links):
                note_receiver(paths, path, v.receiver)
            if wp.static(features.film_glass):
                note_clear(limits, paths, path, v.bounce, scattered, closures)
            seen_by = wp.static(int(Visibility.GLOSSY))
            if (scattered.lobe & TRANSMISSION) != 0:
                seen_by = wp.static(int(Visibility.TRANSMISSION))
            elif (scattered.lobe & DIFFUSE) != 0:
                seen_by = wp.static(int(Visibility.DIFFUSE))
            # one bounce more, and the kind of ray that this scattering makes
            status = (status & wp.static((1 << VISIBILITY_SHIFT) - 1)) | (seen_by << wp.static(VISIBILITY_SHIFT))
            status = status | ((v.bounce + 1) << wp.static(BOUNCE_SHIFT))
            if rays.visibility.shape[0] > 0:
                rays.visibility[path] = seen_by
            if wp.static(features.roulette):
                if goes_on and v.bounce >= limits.roulette_bounce:
                    survival = survival_of(limits, throughput)
                    if sample_1d(v.key, v.pixel.sample, v.dimension + wp.uint32(ROULETTE)) >= survival:
                        goes_on = False
                    throughput = throughput / survival

        far = float(wp.inf)
        if wp.static(features.subsurface):
            if (scattered.lobe & SUBSURFACE) != 0:
                status = status | wp.static(_INSIDE)
                if goes_on:
                    closure = closures[scattered.closure]
                    far = begin_walk(
                        paths,
                        rays,
                        path,
                        closure,
                        surface.position,
                        frame.normal,
                        throughput,
                        v.key,
                        v.pixel.sample,
                        v.bounce + v.passed,
                    )
                    throughput = paths.throughput[path]
                    goes_on = far > 0.0

        if goes_on:
            paths.throughput[path] = throughput
            rays.origin[path] = spawn_origin(
                surface.position, surface.error, frame.geometric_normal, scattered.direction
            )
            rays.direction[path] = scattered.direction
            t_max = far
            if wp.static(features.transparency):
                if (scattered.lobe & TRANSPARENT) != 0:
                    t_max = rays.t_max[path] - hit_t  # the camera's far plane stays where it is
            rays.t_max[path] = t_max
            if wp.static(features.portals):
                pass_portal(paths, rays, path, surface, closures, scattered)
            status = status | wp.static(_RAY_NEW)
        else:
            status = status | wp.static(_ENDED)
        paths.status[path] = status

    return shade_surface
