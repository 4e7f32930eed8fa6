"""Stage: paths whose rays are back go through volumes: they scatter there, or reach what the ray met with what passes.

It stands before the stages at surfaces and of the background, and takes the place of that of lights on the way.

Where a medium is the same everywhere, light is looked for along each piece of a ray, from one point of it, before it is
decided whether the path scatters there: the shadow ray takes a turn of its own. In thin media light would else be
looked for by the few paths alone that scatter.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...scene.description import LightKind, Visibility
from ...scene.features import narrow
from ...scene.program import ProgramFeatures
from ...shading.bsdf.bsdf import BsdfValue
from ...shading.bsdf.materials import address_of
from ...shading.lights.light_choice import VOLUME_SIDE, lit_point
from ...shading.lights.light_hits import LightHitFeatures, make_light_hits
from ...shading.lights.lights import is_lit_in_part
from ...shading.sampling import bitangent_of, spherical_direction, tangent_of, to_world
from ...shading.segments import make_surface_point
from ...shading.sequences.keys import BSDF, DIMENSIONS_PER_BOUNCE, LOBE, ROULETTE
from ...shading.sequences.sampler import make_sampler
from ...shading.volumes.phase import PhaseLobe
from ..passes.light import make_add_light, scattered_by_volume
from ..rays import (
    BOUNCE_SHIFT,
    SHADOW_PASS,
    VISIBILITY_SHIFT,
    Paths,
    Status,
    bounce_of,
    left_side,
    time_of,
    visibility_of,
)
from ..scene.scene_data import SceneData
from ..stages.generate import pixel_sample
from ..stages.limits import PathLimits, clamped, has_light
from ..stages.surface.aim import AimFeatures, is_aimed, make_choose_light
from ..stages.surface.connect_light import make_connect_light
from ..stages.surface.history import DEPTHS
from ..stages.surface.vertex import Vertex
from ..stages.work import TileWork
from .along import lit_length
from .features import VolumeFeatures
from .lights import Way, make_lights_ahead
from .medium import LOBE_FLOATS, LOBES_MOST, has_program, make_medium, passes, phase_sample, phase_sum
from .numbers import CHANNEL, LENGTH, LIGHTS, piece_dimension, stream_of
from .segment import make_segment, ray_point, scattering_shares
from .table import BACK, FRONT, VolumeData, is_empty
from .track import STOPPED

RAY_NEW, ENDED, HIT, INSIDE = int(Status.RAY_NEW), int(Status.ENDED), int(Status.HIT), int(Status.INSIDE)
STRAIGHT, SHADOW_NEW = int(Status.STRAIGHT), int(Status.SHADOW_NEW)
_CAME_BACK = int(Status.HIT | Status.STRAIGHT)
# Pieces of a path's way: more of them are rays that go round in a circle between two surfaces
SEGMENTS_MOST = 1 << 16
# The kind of ray that scattering in a volume makes, as objects and programs see it
_SEEN_BY = int(Visibility.VOLUME_SCATTER)
# What is done at a vertex
_AIM, _SCATTER = 1, 2


# How near to a ray a light is taken to be at least, in shares of its distance
_ASIDE_LEAST = 1e-5
_FARTHEST = 1e30


@wp.func
def _never(volumes: VolumeData, inside: wp.vec4i) -> bool:
    return False


@functools.cache
def volume_kernel(features: VolumeFeatures) -> wp.Kernel:
    """Kernel (data, volumes, work, limits, paths, rays, slots, count). Paths that scatter, or whose way goes on, get a
    new ray; the others have the throughput that is left where their ray ended.
    """
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sample_1d = sampler.sample_1d
    sample_2d = sampler.sample_2d
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    segment = make_segment(features.volume_program)
    medium = make_medium(features.volume_program)
    changes = has_program if features.volume_program else _never
    lights_ahead = make_lights_ahead(features)
    miss = make_light_hits(narrow(features, LightHitFeatures)).miss
    choose_light = make_choose_light(narrow(features, AimFeatures))
    add_light = make_add_light(features.splits_light)
    connect_light = make_connect_light(narrow(features, type(features).__base__))
    constant_medium = make_medium(ProgramFeatures())
    # whether lights have places, towards which points of a ray can be sought
    has_places = features.shadow_rays and (features.mesh_lights or any(k != LightKind.SUN for k in features.lights))

    @wp.func
    def gather(limits: PathLimits, paths: Paths, path: int, light: wp.vec3, bounce: int):
        added = light
        if wp.static(features.clamping):
            added = clamped(limits, light, bounce)
        add_light(paths, path, added, bounce, False)

    @wp.func
    def scattered(
        data: SceneData,
        volumes: VolumeData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        v: Vertex,
        inside: wp.vec4i,
        throughput: wp.vec3,
        tasks: int,
    ) -> int:
        """The path's status after it has looked for light at `v` (_AIM), and scattered there (_SCATTER)."""
        floats = wp.zeros(wp.static(LOBES_MOST * LOBE_FLOATS), dtype=float)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        direction = -v.wo
        point = ray_point(v.surface.position, direction, visibility_of(v.status), v.bounce)
        m = medium(volumes, inside, point, lobes)
        paths.throughput[path] = throughput
        paths.passed[path] = v.passed + v.passed * wp.static(SHADOW_PASS)
        if paths.shadow_history.shape[0] > 0:
            paths.shadow_history[path] = paths.history[path]
        status = v.status
        if wp.static(features.shadow_rays):
            if (tasks & wp.static(_AIM)) != 0 and is_aimed(data.lights, limits, v):
                light = choose_light(data, paths, path, v)
                if light.pdf > 0.0:
                    seen = phase_sum(lobes, m, throughput, wp.dot(direction, light.direction))
                    value = BsdfValue()
                    value.value = seen.value
                    value.pdf = seen.pdf
                    if is_lit_in_part(light.visibility):
                        # such lights shine into volumes all the same
                        light.visibility = wp.static(int(Visibility.TRANSMISSION))
                    status = status | connect_light(limits, paths, rays, path, v, light, value)
                    if wp.static(features.splits_light):
                        if v.bounce == 0 and paths.passes.shape[0] > 0:
                            scattered_by_volume(paths, path, True)
                    volumes.state.shadow_inside[path] = inside
                    volumes.state.shadow_segment[path] = 0
        if (tasks & wp.static(_SCATTER)) == 0:
            return status
        u = sample_2d(v.key, v.where.sample, v.dimension + wp.uint32(BSDF))
        u_lobe = sample_1d(v.key, v.where.sample, v.dimension + wp.uint32(LOBE))
        cosine = phase_sample(lobes, m, throughput, u_lobe, u[0])
        new = to_world(
            spherical_direction(cosine, wp.TAU * u[1]), tangent_of(direction), bitangent_of(direction), direction
        )
        chosen = phase_sum(lobes, m, throughput, cosine)
        carried = wp.vec3(0.0)
        if chosen.pdf > 0.0:
            carried = wp.cw_mul(throughput, chosen.value) / chosen.pdf
        goes_on = has_light(carried)
        if wp.static(features.roulette):
            if goes_on and v.bounce >= limits.roulette_bounce:
                largest = wp.max(carried[0], wp.max(carried[1], carried[2]))
                survival = wp.min(largest / limits.roulette_throughput, 1.0)
                if sample_1d(v.key, v.where.sample, v.dimension + wp.uint32(ROULETTE)) >= survival:
                    goes_on = False
                carried = carried / survival
        if not goes_on:
            return status | wp.static(ENDED)
        if wp.static(features.splits_light):
            if v.bounce == 0 and paths.passes.shape[0] > 0:
                scattered_by_volume(paths, path, False)
        if paths.history.shape[0] > 0:
            paths.history[path] = paths.history[path] & wp.static(DEPTHS)
        paths.throughput[path] = carried
        paths.pdf[path] = wp.where(v.where.x < limits.nee_end, chosen.pdf, 0.0)
        paths.passed_t[path] = 0.0
        if paths.side.shape[0] > 0:
            paths.side[path] = v.side
        if paths.cone.shape[0] > 0:
            paths.cone[path] = wp.vec2(0.0, 0.0)
        rays.origin[path] = v.surface.position
        rays.direction[path] = new
        rays.t_max[path] = wp.inf
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(_SEEN_BY)
        status = (status & wp.static((1 << VISIBILITY_SHIFT) - 1)) | wp.static(_SEEN_BY << VISIBILITY_SHIFT)
        bounce = v.bounce + 1
        if volumes.state.scattered[path] > volumes.bounce_max:
            # the path has been scattered by volumes as often as it may: it finds light alone, as in Cycles
            bounce = wp.max(bounce, limits.bounce_max + 1)
        return status | (bounce << wp.static(BOUNCE_SHIFT)) | wp.static(RAY_NEW)

    @wp.func
    def lit_along(
        data: SceneData,
        volumes: VolumeData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        v: Vertex,
        inside: wp.vec4i,
        length: float,
    ) -> bool:
        """Look for light from a point of the piece of `length` [m] ahead; False where there is nothing to be lit. The
        path waits for a shadow ray then, and is as it was.
        """
        floats = wp.zeros(wp.static(LOBES_MOST * LOBE_FLOATS), dtype=float)
        lobes = wp.array(ptr=address_of(floats), shape=(wp.static(LOBES_MOST),), dtype=PhaseLobe)
        origin = rays.origin[path]
        direction = -v.wo
        m = constant_medium(volumes, inside, ray_point(origin, direction, 0, 0), lobes)
        throughput = paths.throughput[path]
        reach = wp.min(length, wp.static(_FARTHEST))
        if not (wp.dot(throughput, m.scattering) > 0.0 and reach > 0.0):
            return False
        shares = scattering_shares(throughput, m.scattering, m.extinction)
        nearest = float(0.0)
        aside = float(0.0)
        if wp.static(has_places):
            # a light that is chosen halfway, or one free path ahead
            ahead = wp.min(0.5 * reach, 1.0 / wp.max(wp.dot(shares, m.extinction), 1.0e-30))
            v.surface.position = origin + ahead * direction
            light = choose_light(data, paths, path, v)
            if light.pdf > 0.0 and light.distance < wp.inf:
                way = light.distance * light.direction
                nearest = ahead + wp.dot(way, direction)
                far = wp.length(wp.cross(way, direction))
                aside = wp.max(far, wp.static(_ASIDE_LEAST) * (ahead + light.distance))
        piece = v.dimension - wp.uint32(wp.static(LIGHTS))
        u = wp.vec2(
            sample_1d(v.key, v.where.sample, piece + wp.uint32(wp.static(CHANNEL))),
            sample_1d(v.key, v.where.sample, piece + wp.uint32(wp.static(LENGTH))),
        )
        found = lit_length(m.extinction, shares, reach, nearest, aside, u)
        if not found[1] > 0.0:
            return False
        v.surface.position = origin + found[0] * direction
        carried = wp.cw_mul(throughput, wp.cw_mul(m.scattering, passes(m.extinction, found[0]))) / found[1]
        sent = scattered(data, volumes, limits, paths, rays, path, v, inside, carried, wp.static(_AIM))
        paths.throughput[path] = throughput
        if (sent & wp.static(SHADOW_NEW)) == 0:
            return False
        # the shadow ray comes from behind one scattering more
        paths.passed[path] = paths.passed[path] + 1
        paths.status[path] = paths.status[path] | wp.static(SHADOW_NEW | STRAIGHT)
        volumes.state.lit[path] = 1
        return True

    @wp.kernel(**KERNEL_OPTIONS)
    def scatter(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = wp.tid()
        if i >= count[0]:
            return
        path = slots[i]
        status = paths.status[path]
        volumes.state.side[path] = 0
        if wp.static(features.subsurface):
            if (status & wp.static(INSIDE)) != 0:
                # a walk below a surface that came out, as if it had been reflected there
                volumes.state.side[path] = wp.static(FRONT)
                return
        origin = rays.origin[path]
        direction = rays.direction[path]
        hit = bool(rays.hit_instance[path] >= 0)
        length = rays.t_max[path]
        if hit:
            length = rays.hit_t[path]
            surface = surface_point(
                data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
            )
            volumes.state.side[path] = wp.where(
                wp.dot(surface.geometric_normal, direction) > 0.0, wp.static(BACK), wp.static(FRONT)
            )
        bounce = bounce_of(status)
        is_lit = bool(False)
        if volumes.state.lit[path] != 0:
            # light has been looked for along this piece
            is_lit = True
            volumes.state.lit[path] = 0
            paths.passed[path] = paths.passed[path] - 1
            status = status & wp.static(~STRAIGHT)
            paths.status[path] = status
        passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        before = paths.passed_t[path]
        throughput = paths.throughput[path]
        pdf = paths.pdf[path]
        inside = volumes.state.inside[path]
        number = int(volumes.state.segment[path])
        volumes.state.segment[path] = number + 1
        where = pixel_sample(work, paths.item[path])
        key = pixel_key(limits.seed, wp.uint32(where.x), wp.uint32(where.y), wp.uint32(work.frame_width))
        stream = stream_of(key, where.sample, wp.uint32(number))
        begin = ray_point(origin, direction, visibility_of(status), bounce)
        scatters = bounce <= limits.bounce_max and volumes.state.scattered[path] <= volumes.bounce_max
        v = Vertex()
        v.there = True
        v.status = status & ~wp.static(_CAME_BACK)
        v.bounce = bounce
        v.passed = passed
        v.where = where
        v.key = key
        v.wo = -direction
        v.side = wp.uint32(VOLUME_SIDE)
        tasks = int(wp.static(_AIM | _SCATTER))
        if wp.static(features.shadow_rays):
            if not is_empty(volumes, inside) and not changes(volumes, inside):
                tasks = int(wp.static(_SCATTER))
                if not is_lit and scatters and is_aimed(data.lights, limits, v):
                    v.dimension = piece_dimension(number) + wp.uint32(wp.static(LIGHTS))
                    if lit_along(data, volumes, limits, paths, rays, path, v, inside, length):
                        return
                    # where the path scatters must not depend on why no shadow ray was sent
                    number += 1
                    volumes.state.segment[path] = number + 1

        event = int(0)
        reach = length
        left = throughput
        if not is_empty(volumes, inside):
            dimension = piece_dimension(number)
            u = wp.vec2(
                sample_1d(key, where.sample, dimension + wp.uint32(wp.static(CHANNEL))),
                sample_1d(key, where.sample, dimension + wp.uint32(wp.static(LENGTH))),
            )
            way = segment(volumes, inside, begin, length, throughput, scatters, u, stream)
            event = way.event
            if event != 0:
                reach = way.length
            left = wp.cw_mul(throughput, way.weight)
            if has_light(way.emitted):
                gather(limits, paths, path, wp.cw_mul(throughput, way.emitted), bounce)

        if wp.static(features.light_hits):
            ahead = Way()
            ahead.begin = begin
            ahead.inside = inside
            ahead.before = before
            ahead.length = length
            if event == wp.static(STOPPED):
                ahead.length = reach
            ahead.bsdf_pdf = pdf
            ahead.passed = passed
            ahead.stream = stream
            last = lit_point(origin - before * direction, left_side(paths, path))
            met = lights_ahead(volumes, data.lights, data.lamp_nodes, last, ahead)
            gather(limits, paths, path, wp.cw_mul(throughput, met), bounce)
            if not hit and event == 0:
                suns = miss(
                    data.lights, data.lamp_nodes, last, direction, visibility_of(status), pdf, bounce + 1, passed
                )
                gather(limits, paths, path, wp.cw_mul(left, suns), bounce)

        if event == 0:
            paths.throughput[path] = left
            if (bounce > 0 and not has_light(left)) or number >= wp.static(SEGMENTS_MOST):
                paths.status[path] = status | wp.static(ENDED)
            return
        volumes.state.side[path] = 0
        if event == wp.static(STOPPED):
            paths.throughput[path] = left
            paths.passed_t[path] = before + reach
            rays.origin[path] = origin + reach * direction
            rays.t_max[path] = rays.t_max[path] - reach
            status = status & wp.static(~HIT)
            if has_light(left) and number < wp.static(SEGMENTS_MOST):
                paths.status[path] = status | wp.static(RAY_NEW)
            else:
                paths.status[path] = status | wp.static(ENDED)
            return
        volumes.state.scattered[path] = volumes.state.scattered[path] + 1
        v.dimension = wp.uint32(bounce + passed) * wp.uint32(DIMENSIONS_PER_BOUNCE)
        v.surface.position = origin + reach * direction
        paths.status[path] = scattered(data, volumes, limits, paths, rays, path, v, inside, left, tasks)

    return scatter
