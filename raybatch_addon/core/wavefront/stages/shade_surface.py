"""Stage: a ray has met a surface. It emits, a light is sampled, and the path scatters. Next: `trace`, or
`accumulate`.
"""

from __future__ import annotations

import functools

import warp as wp

from ...film.tile import FilmTile
from ...rays import Rays
from ...scene.description import ClosureKind, Visibility
from ...scene.features import narrow
from ...shading.bsdf.bsdf import DELTA, DIFFUSE, SUBSURFACE, TRANSMISSION, TRANSPARENT, ClosureFeatures, make_bsdf
from ...shading.bsdf.materials import RECORD_FLOATS, SURFACE_NORMAL, ClosureRecord, address_of, new_closure
from ...shading.bsdf.normals import shading_frame
from ...shading.lights.light_choice import packed_side
from ...shading.lights.lights import LightFeatures, light_weights, make_lights
from ...shading.sampling import (
    BSDF,
    DIMENSIONS_PER_BOUNCE,
    LIGHT,
    LIGHT_CHOICE,
    LOBE,
    ROULETTE,
    bitangent_of,
    make_sampler,
    pixel_key,
    tangent_of,
)
from ...shading.surface import make_surface, spawn_origin
from ..rays import BOUNCE_SHIFT, SHADOW_PASS, VISIBILITY_SHIFT, Paths, Status, bounce_of, visibility_of
from ..scene.scene_data import SceneData
from .aim import make_connect_light
from .emission import make_gather_emission
from .generate import pixel_sample
from .history import history_after
from .limits import PathLimits, has_light
from .surface_features import SurfaceFeatures
from .surface_program import fixed_closure_count, fixed_closures, make_surface_program, program_of, shading_point
from .walk import STEPS_MOST, make_walk_begin, walk_dimension
from .work import TileWork

RAY_NEW = int(Status.RAY_NEW)
HIT = int(Status.HIT)
STRAIGHT = int(Status.STRAIGHT)
ENDED = int(Status.ENDED)
INSIDE = int(Status.INSIDE)
# Closures that light from behind the surface shines through, in other directions than straight on
TRANSMISSIVE = (ClosureKind.GLASS, ClosureKind.REFRACTION, ClosureKind.TRANSLUCENT, ClosureKind.SHEET)
_GLASS, _REFRACTION, _TRANSLUCENT, _SHEET = (int(kind) for kind in TRANSMISSIVE)


@wp.func
def is_transmissive(kind: int) -> bool:
    """Whether a closure is one of `TRANSMISSIVE`."""
    return (
        kind == wp.static(_GLASS)
        or kind == wp.static(_REFRACTION)
        or kind == wp.static(_TRANSLUCENT)
        or kind == wp.static(_SHEET)
    )


@functools.cache
def make_shade_surface(features: SurfaceFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it."""
    sampler = make_sampler(features.sample_sequence)
    sample_1d = sampler.sample_1d
    sample_2d = sampler.sample_2d
    surface_point = make_surface(features.instancing, features.smooth_normals).point
    bsdf = make_bsdf(ClosureFeatures(features.closures))
    bsdf_sample = bsdf.sample
    bsdf_holdout = bsdf.holdout
    lights = make_lights(narrow(features, LightFeatures))
    sample_weight, hit_weight = light_weights(features.mis)
    gather_emission = make_gather_emission(bsdf.emission, lights.hit_pdf, hit_weight, features.clamping)
    connect_light = make_connect_light(features, bsdf.evaluate, lights.sample, sample_weight)
    programs = features.programs
    run_surface = make_surface_program(programs)
    begin_walk = make_walk_begin(features.sample_sequence)
    transmits = any(kind in features.closures for kind in TRANSMISSIVE)

    @wp.func
    def shade_surface(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        status = paths.status[path] & ~wp.static(HIT | STRAIGHT)
        bounce = bounce_of(status)
        where = pixel_sample(work, paths.item[path])
        sample = where.sample
        direction = rays.direction[path]
        wo = -direction
        comes_out = bool(False)
        if wp.static(features.subsurface):
            if (status & wp.static(INSIDE)) != 0:
                if paths.walk.step[path] != 0:
                    return  # a step of a walk that ended before the surface, or met another object
                status = status & wp.static(~INSIDE)
                comes_out = True
                wo = direction
        hit_t = rays.hit_t[path]
        passed = int(0)
        passed_t = float(0.0)
        if wp.static(features.transparency):
            passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
            passed_t = paths.passed_t[path]
        surface = surface_point(data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path])
        frame = shading_frame(surface, wo)
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
                point.bounce = bounce
                point.passed = passed
                if wp.static(features.path_history):
                    point.history = paths.history[path]
                records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=float)
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
            if wp.static(features.subsurface):
                if comes_out:  # Lambert's law, about the medium's own normal
                    white = new_closure(wp.static(int(ClosureKind.DIFFUSE)), wp.vec3(1.0))
                    for c in range(first, end):
                        if made[c].kind == wp.static(int(ClosureKind.SUBSURFACE)):
                            white.normal = made[c].normal
                    one = wp.zeros(wp.static(RECORD_FLOATS), dtype=float)
                    whites = wp.array(ptr=address_of(one), shape=(1,), dtype=ClosureRecord)
                    whites[0] = white
                    address = address_of(one)
                    first = 0
                    end = 1
            closures = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        else:
            closures = data.materials.closures
            first = int(data.materials.closure_first[surface.material])
            end = int(data.materials.closure_first[surface.material + 1])
            if wp.static(features.subsurface):
                if comes_out:  # a white closure lies behind those of the materials
                    end = closures.shape[0]
                    first = end - 1

        if bounce == 0 and passed == 0 and not comes_out:
            if wp.static("Normal" in features.passes):
                if paths.normal.shape[0] > 0:
                    paths.normal[path] = frame.normal
            if sample == wp.uint32(0):
                if wp.static("Depth" in features.passes):
                    if film.depth.shape[0] > 0:
                        film.depth[where.pixel] = wp.dot(surface.position - data.view_origin, data.view_axis)
                if wp.static("Position" in features.passes):
                    if film.position.shape[0] > 0:
                        film.position[where.pixel] = surface.position

        if wp.static(features.film_holes):
            if bounce == 0 and paths.alpha.shape[0] > 0:
                carried = paths.throughput[path]
                seen = (carried[0] + carried[1] + carried[2]) / 3.0
                paths.alpha[path] = paths.alpha[path] - seen * bsdf_holdout(closures, first, end)

        if wp.static(features.emission):
            gather_emission(data, limits, paths, rays, path, closures, first, end, passed_t)

        # at its last surface a path scatters no more, but still passes what is transparent, as shadow rays do
        last = bounce > limits.bounce_max
        if wp.static(not features.transparency):
            if last:
                paths.status[path] = status | wp.static(ENDED)
                return

        x = where.x
        key = pixel_key(limits.seed, wp.uint32(where.y) * wp.uint32(work.frame_width) + wp.uint32(x))
        # every surface that a path meets has numbers of its own, also those that it passes
        dimension = wp.uint32(bounce + passed) * wp.uint32(DIMENSIONS_PER_BOUNCE)
        if wp.static(features.subsurface):
            if comes_out:
                dimension = walk_dimension(bounce + passed, wp.static(STEPS_MOST + 1))

        side = wp.uint32(0)
        if wp.static(features.shadow_rays):
            both_sides = bool(False)
            if wp.static(features.light_choice):
                if wp.static(transmits):
                    for c in range(first, end):
                        both_sides = both_sides or is_transmissive(closures[c].kind)
                side = packed_side(frame.normal, both_sides)
            if x < limits.nee_end and not last:
                status = status | connect_light(
                    data,
                    limits,
                    paths,
                    rays,
                    path,
                    surface,
                    frame,
                    wo,
                    closures,
                    first,
                    end,
                    side,
                    sample_1d(key, sample, dimension + wp.uint32(LIGHT_CHOICE)),
                    sample_2d(key, sample, dimension + wp.uint32(LIGHT)),
                )

        scattered = bsdf_sample(
            closures,
            first,
            end,
            data.materials.albedo,
            frame,
            wo,
            sample_1d(key, sample, dimension + wp.uint32(LOBE)),
            sample_2d(key, sample, dimension + wp.uint32(BSDF)),
        )
        throughput = wp.cw_mul(paths.throughput[path], scattered.weight)
        goes_on = has_light(throughput) and (not last or (scattered.lobe & TRANSPARENT) != 0)

        if wp.static(features.transparency):
            if (scattered.lobe & TRANSPARENT) != 0:
                # the path goes straight on: it remembers where it last scattered, and how
                goes_on = goes_on and passed < limits.transparent_bounce_max
                paths.passed[path] = passed + 1 + passed * wp.static(SHADOW_PASS)
                paths.passed_t[path] = passed_t + hit_t
                status = status | wp.static(STRAIGHT)
            else:
                paths.passed[path] = passed + passed * wp.static(SHADOW_PASS)
                paths.passed_t[path] = 0.0
        if wp.static(features.path_history):
            if wp.static(features.shadow_rays):
                paths.shadow_history[path] = paths.history[path]
            if (scattered.lobe & (TRANSPARENT | SUBSURFACE)) == 0:
                paths.history[path] = history_after(paths.history[path], scattered.lobe)
        if (scattered.lobe & (TRANSPARENT | SUBSURFACE)) == 0:
            pdf = scattered.pdf
            if (scattered.lobe & DELTA) != 0 or x >= limits.nee_end:
                pdf = 0.0
            paths.pdf[path] = pdf
            if wp.static(features.shadow_rays and features.light_choice):
                paths.side[path] = side
            seen_by = wp.static(int(Visibility.GLOSSY))
            if (scattered.lobe & TRANSMISSION) != 0:
                seen_by = wp.static(int(Visibility.TRANSMISSION))
            elif (scattered.lobe & DIFFUSE) != 0:
                seen_by = wp.static(int(Visibility.DIFFUSE))
            # one bounce more, and the kind of ray that this scattering makes
            status = (status & wp.static((1 << VISIBILITY_SHIFT) - 1)) | (seen_by << wp.static(VISIBILITY_SHIFT))
            status = status | ((bounce + 1) << wp.static(BOUNCE_SHIFT))
            if rays.visibility.shape[0] > 0:
                rays.visibility[path] = seen_by
            if wp.static(features.roulette):
                if goes_on and bounce >= limits.roulette_bounce:
                    survival = wp.min(wp.max(throughput[0], wp.max(throughput[1], throughput[2])), 1.0)
                    if sample_1d(key, sample, dimension + wp.uint32(ROULETTE)) >= survival:
                        goes_on = False
                    throughput = throughput / survival

        far = float(wp.inf)
        if wp.static(features.subsurface):
            if (scattered.lobe & SUBSURFACE) != 0:
                status = status | wp.static(INSIDE)
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
                        key,
                        sample,
                        bounce + passed,
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
            status = status | wp.static(RAY_NEW)
        else:
            status = status | wp.static(ENDED)
        paths.status[path] = status

    return shade_surface
