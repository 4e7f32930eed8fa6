"""Stage: paths whose rays are back go through volumes: they scatter there, or reach what the ray met with what passes.

It stands before the stages at surfaces and of the background, and takes the place of that of lights on the way.

Light is looked for along each piece of a ray, from one point of it, whether the path scatters there or not: in thin
media light would else be looked for by the few paths alone that scatter. Where the path passes, the shadow ray takes a
turn of its own.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...rays import Rays
from ...scene.description import LightKind
from ...scene.features import narrow
from ...shading.bsdf.materials import address_of
from ...shading.lights.choice import VOLUME_SIDE
from ...shading.lights.hits import LightHitFeatures, make_light_hits
from ...shading.lights.links import group_of, is_linked, owner_of_world, receiver_of
from ...shading.segments import make_surface_point
from ...shading.sequences.keys import DIMENSIONS_PER_BOUNCE
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import material_at
from ...shading.volumes.enclosures import FARTHEST
from ...shading.volumes.numbers import CHANNEL, LENGTH, LIGHTS, LIT_CHANNEL, LIT_LENGTH, piece_dimension, stream_of
from ...shading.volumes.phase import PhaseLobe
from ..catchers.copies import is_in_vacuum
from ..passes.guides import note_seen_light, note_volume
from ..passes.light import add_to_group, make_add_light
from ..rays import CAME_BACK, SHADOW_PASS, Paths, Status, bounce_of, left_point, time_of, visibility_of
from ..scene.shading_data import SceneData
from ..stages.generate import pixel_sample
from ..stages.limits import PathLimits, clamped, has_light
from ..stages.surface.aim import AimFeatures, is_aimed, make_choose_light
from ..stages.surface.vertex import Vertex
from ..stages.work import TileWork
from .along import Sought, sought_in_bounds, sought_in_constant, towards_light
from .emission.weigh import Seen, is_unaimed, make_weighed, make_weighed_constant, weighed_grid
from .features import VolumeFeatures
from .lights import Way, make_lights_ahead
from .medium import LOBES_MOST, PHASE_LOBE_FLOATS, Coefficients, make_constant_medium, may_vary, varies_along
from .segment import constant_way, ray_point, scattering_shares
from .table import (
    AIMED,
    BACK,
    FRONT,
    GOES_ON,
    IN_VACUUM,
    PATHS_CUT,
    UNAIMED,
    VolumeData,
    innermost_instance,
    is_empty,
    note_count,
)
from .track import SCATTERED, STOPPED, Track, make_track
from .vertex import make_aim_in_volume, make_scattered

_RAY_NEW, _ENDED, _HIT, _INSIDE = int(Status.RAY_NEW), int(Status.ENDED), int(Status.HIT), int(Status.INSIDE)
_STRAIGHT, _SHADOW_NEW = int(Status.STRAIGHT), int(Status.SHADOW_NEW)
# Pieces of a path's way: more of them are rays that go round in a circle between two surfaces
SEGMENTS_MOST = 1 << 16


@functools.cache
def make_scatter(features: VolumeFeatures) -> wp.Function:
    """Function (data, volumes, work, limits, paths, rays, path: int). A path that scatters, or whose way goes on, gets
    a new ray; another has the throughput that is left where its ray ended.
    """
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sample_1d = sampler.sample_1d
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    varies = may_vary(features.volume_program)
    weighed = make_weighed(features) if features.volume_lights else None
    weighed_constant = make_weighed_constant(weighed) if features.volume_lights else None
    track = make_track(features.volume_program, weighed) if varies else None
    lights_ahead = make_lights_ahead(features)
    miss = make_light_hits(narrow(features, LightHitFeatures)).miss
    aim = make_aim_in_volume(features)
    scattered = make_scattered(features)
    choose_light = make_choose_light(narrow(features, AimFeatures))
    add_light = make_add_light(features.splits_light, features.light_groups)
    constant_medium = make_constant_medium(features.volume_program)
    # whether lights have places, towards which points of a ray can be sought
    placed = features.mesh_lights or features.volume_lights or any(k != LightKind.SUN for k in features.lights)
    has_places = features.shadow_rays and placed

    @wp.func
    def gather(limits: PathLimits, paths: Paths, path: int, light: wp.vec3, bounce: int, group: int):
        added = light
        if wp.static(features.clamping):
            added = clamped(limits, light, bounce)
        before = paths.radiance[path]
        add_light(paths, path, added, bounce, False)
        if wp.static(features.guides):
            note_seen_light(paths, path, before)
        if wp.static(features.light_groups):
            add_to_group(paths, path, added, group)

    @wp.func
    def side_of(data: SceneData, volumes: VolumeData, paths: Paths, rays: Rays, path: int) -> int:
        """The side of the surface that the path came to; FRONT where the other side is the same to it."""
        instance = rays.hit_instance[path]
        primitive = rays.hit_primitive[path]
        material = material_at(data.geometry, instance, primitive)
        if volumes.volume_of[material] < 0 and volumes.enclosures.touching == 0:
            return wp.static(FRONT)
        surface = surface_point(data.geometry, instance, primitive, rays.hit_uv[path], time_of(rays, path))
        return wp.where(wp.dot(surface.geometric_normal, rays.direction[path]) > 0.0, wp.static(BACK), wp.static(FRONT))

    @wp.func
    def seek(data: SceneData, paths: Paths, path: int, v: Vertex, origin: wp.vec3, sought: Sought) -> Sought:
        """`sought` by the light that is chosen from its middle."""
        result = sought
        if wp.static(has_places):
            v.surface.position = origin - sought.middle * v.wo
            light = choose_light(data, paths, path, v)
            if light.pdf > 0.0 and light.distance < wp.inf:
                result = towards_light(sought, light.distance * light.direction, -v.wo)
        return result

    @wp.func
    def reach_end(data: SceneData, volumes: VolumeData, paths: Paths, rays: Rays, path: int, status: int):
        """What the path's ray met is next; `status`: the path's."""
        if rays.hit_instance[path] >= 0:
            volumes.state.side[path] = side_of(data, volumes, paths, rays, path)
        over = volumes.state.segment[path] >= wp.static(SEGMENTS_MOST)
        if over:
            note_count(volumes.counts, wp.uint32(path), wp.static(PATHS_CUT), wp.int64(1))
        if (bounce_of(status) > 0 and not has_light(paths.throughput[path])) or over:
            status = status | wp.static(_ENDED)
        paths.status[path] = status

    @wp.func
    def scatter(
        data: SceneData, volumes: VolumeData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int
    ):
        status = paths.status[path]
        volumes.state.side[path] = 0
        if wp.static(features.subsurface):
            if (status & wp.static(_INSIDE)) != 0:
                # a walk below a surface that came out, as if it had been reflected there
                volumes.state.side[path] = wp.static(FRONT)
                return
        origin = rays.origin[path]
        direction = rays.direction[path]
        hit = bool(rays.hit_instance[path] >= 0)
        length = rays.t_max[path]
        if hit:
            length = rays.hit_t[path]
        floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        lit_floats = wp.zeros(wp.static(LOBES_MOST * PHASE_LOBE_FLOATS), dtype=Unset)
        lit_lobes = wp.array(ptr=address_of(lit_floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        bounce = bounce_of(status)
        goes_on = (volumes.state.lit[path] & wp.static(GOES_ON)) != 0
        if (volumes.state.lit[path] & wp.static(AIMED)) != 0:
            # a shadow ray is back
            paths.passed[path] = paths.passed[path] - 1
            status = status & wp.static(~_STRAIGHT)
            paths.status[path] = status
            # those from behind this piece have other random numbers
            volumes.state.segment[path] = volumes.state.segment[path] + 1
            volumes.state.lit[path] = volumes.state.lit[path] & wp.static(GOES_ON | UNAIMED)
            if not goes_on:
                reach_end(data, volumes, paths, rays, path, status)
                return
        passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        before = paths.passed_t[path]
        throughput = paths.throughput[path]
        pdf = paths.pdf[path]
        inside = volumes.state.inside[path]
        empty = is_empty(volumes, inside)
        if wp.static(features.catchers):
            empty = empty or is_in_vacuum(paths, path, inside)
        number = int(volumes.state.segment[path])
        volumes.state.segment[path] = number + 1
        pixel = pixel_sample(work, paths.item[path])
        key = pixel_key(limits.seed, wp.uint32(pixel.x), wp.uint32(pixel.y), wp.uint32(work.frame_width))
        stream = stream_of(key, pixel.sample, wp.uint32(number))
        begin = ray_point(origin, direction, visibility_of(status), bounce, time_of(rays, path))
        scatters = bounce <= limits.bounce_max and volumes.state.scattered[path] <= volumes.bounce_max
        v = Vertex()
        v.there = True
        v.status = status & ~wp.static(CAME_BACK)
        v.bounce = bounce
        v.passed = passed
        v.pixel = pixel
        v.key = key
        v.wo = -direction
        v.side = wp.uint32(VOLUME_SIDE)
        if wp.static(features.light_links):
            v.receiver = receiver_of(data.lights, innermost_instance(inside, volumes.volume_count))
        noted = int(0)
        if wp.static(features.volume_lights):
            noted = volumes.state.lit[path] & wp.static(UNAIMED)
            if before == 0.0:
                noted = wp.where(is_unaimed(volumes, inside), wp.static(UNAIMED), 0)
        volumes.state.lit[path] = noted
        event = int(0)
        reach = length
        weight = wp.vec3(1.0, 1.0, 1.0)
        medium = Coefficients()
        sent = int(0)
        if not empty:
            dimension = piece_dimension(number)
            v.dimension = dimension + wp.uint32(wp.static(LIGHTS))
            seeks = bool(False)
            if wp.static(features.shadow_rays):
                seeks = scatters and volumes.scatters != 0 and is_aimed(data.lights, limits, v)
            way = Track()
            far = wp.min(length, wp.static(FARTHEST))
            sought = Sought()
            seen = Seen()
            if wp.static(features.volume_lights):
                seen.pdf = wp.where(noted == 0, pdf, 0.0)
                seen.point = left_point(paths, path, origin - before * direction)
            changes = bool(False)
            if wp.static(varies):
                changes = varies_along(volumes, inside)
            if changes:
                if wp.static(varies):
                    if seeks:
                        sought = sought_in_bounds(volumes, inside, origin, direction, begin.time, far)
                        sought = seek(data, paths, path, v, origin, sought)
                        sought.seeks = 1
                    way = track(
                        volumes,
                        inside,
                        begin,
                        far,
                        throughput,
                        scatters,
                        sought,
                        stream,
                        lobes,
                        lit_lobes,
                        data.lights,
                        seen,
                    )
            else:
                m = constant_medium(volumes, inside, begin, lobes)
                u = wp.vec2(
                    sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(CHANNEL))),
                    sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(LENGTH))),
                )
                u_lit = wp.vec2(0.0, 0.0)
                seeks = seeks and wp.dot(throughput, m.scattering) > 0.0
                if seeks:
                    u_lit = wp.vec2(
                        sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(LIT_CHANNEL))),
                        sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(LIT_LENGTH))),
                    )
                    mean = wp.dot(scattering_shares(throughput, m.scattering, m.extinction), m.extinction)
                    sought = seek(data, paths, path, v, origin, sought_in_constant(mean, far))
                    for k in range(m.lobes):
                        lit_lobes[k] = lobes[k]
                way = constant_way(m, far, throughput, scatters, seeks, sought, u_lit, u)
                if wp.static(features.volume_lights):
                    if seen.pdf > 0.0 and has_light(m.emission) and weighed_grid(volumes, inside) >= 0:
                        way.emitted = weighed_constant(volumes, data.lights, seen, inside, begin, m, far, stream)
            medium = way.medium
            event = way.event
            if event != 0:
                reach = way.length
            weight = way.weight
            emits = has_light(way.emitted)
            group = int(-1)
            if wp.static(features.light_links or features.light_groups):
                owner = owner_of_world(data.lights)
                instance = innermost_instance(inside, volumes.volume_count)
                if instance >= 0:
                    owner = data.lights.light_count + instance
                if wp.static(features.light_links):
                    emits = emits and is_linked(data.lights, owner, left_point(paths, path, origin).receiver)
                if wp.static(features.light_groups):
                    group = group_of(data.lights, owner)
            if emits:
                gather(limits, paths, path, wp.cw_mul(throughput, way.emitted), bounce, group)
            if wp.static(features.shadow_rays):
                carried = wp.cw_mul(throughput, way.lit.weight)
                if has_light(carried):
                    v.surface.position = origin + way.lit.length * direction
                    sent = aim(data, volumes, limits, paths, rays, path, v, inside, carried, way.lit.medium, lit_lobes)
                    if event != wp.static(SCATTERED) and sent != 0:
                        # it comes from behind one scattering more
                        sent = wp.static(_SHADOW_NEW | _STRAIGHT)
                        paths.passed[path] = paths.passed[path] + 1
                        volumes.state.lit[path] = noted | wp.static(AIMED)

        left = wp.cw_mul(throughput, weight)
        if wp.static(features.light_hits):
            ahead = Way()
            ahead.begin = begin
            ahead.inside = inside
            if wp.static(features.catchers):
                if empty:
                    ahead.inside = wp.vec4i(wp.static(IN_VACUUM))
            ahead.before = before
            ahead.length = length
            ahead.bsdf_pdf = pdf
            ahead.passed = passed
            ahead.stream = stream
            last = left_point(paths, path, origin - before * direction)
            if not goes_on:
                met = lights_ahead(volumes, data.lights, data.lamp_nodes, last, ahead)
                gather(limits, paths, path, wp.cw_mul(throughput, met), bounce, -1)
            if not hit and event == 0:
                suns = miss(
                    data.lights, data.lamp_nodes, last, direction, visibility_of(status), pdf, bounce + 1, passed
                )
                gather(limits, paths, path, wp.cw_mul(left, suns), bounce, -1)
            if wp.static(features.light_groups):
                for of in range(data.lights.choice[0].links.group_count):
                    last.group = of
                    of_group = wp.vec3()
                    if not goes_on:
                        met = lights_ahead(volumes, data.lights, data.lamp_nodes, last, ahead)
                        of_group = wp.cw_mul(throughput, met)
                    if not hit and event == 0:
                        suns = miss(
                            data.lights, data.lamp_nodes, last, direction, ahead.begin.ray_kind, pdf, bounce + 1, passed
                        )
                        of_group = of_group + wp.cw_mul(left, suns)
                    if wp.static(features.clamping):
                        of_group = clamped(limits, of_group, bounce)
                    add_to_group(paths, path, of_group, of)

        status = status | sent
        if event == 0:
            paths.throughput[path] = left
            if sent != 0:
                paths.status[path] = status
            else:
                reach_end(data, volumes, paths, rays, path, status)
            return
        if event == wp.static(STOPPED):
            volumes.state.lit[path] = volumes.state.lit[path] | wp.static(GOES_ON)
            paths.throughput[path] = left
            paths.passed_t[path] = before + reach
            rays.origin[path] = origin + reach * direction
            rays.t_max[path] = rays.t_max[path] - reach
            status = status & wp.static(~_HIT)
            if has_light(left) and number < wp.static(SEGMENTS_MOST):
                paths.status[path] = status | wp.static(_RAY_NEW)
            else:
                if has_light(left):
                    note_count(volumes.counts, stream, wp.static(PATHS_CUT), wp.int64(1))
                paths.status[path] = status | wp.static(_ENDED)
            return
        volumes.state.scattered[path] = volumes.state.scattered[path] + 1
        if wp.static(features.guides):
            note_volume(paths, path, weight)
        v.dimension = wp.uint32(bounce + passed) * wp.uint32(DIMENSIONS_PER_BOUNCE)
        v.surface.position = origin + reach * direction
        paths.status[path] = sent | scattered(volumes, limits, paths, rays, path, v, left, medium, lobes)

    return scatter
