"""A vertex of a path in a volume: light is looked for there, and the path is scattered."""

from __future__ import annotations

import functools

import warp as wp

from ...rays import Rays
from ...scene.description import Visibility
from ...scene.features import narrow
from ...shading.bsdf.bsdf import BsdfValue
from ...shading.sampling import bitangent_of, spherical_direction, tangent_of, to_world
from ...shading.sequences.keys import BSDF, ROULETTE
from ...shading.sequences.sampler import make_sampler
from ...shading.volumes.phase import PhaseLobe
from ..passes.light import divide_volume_ray
from ..rays import BOUNCE_SHIFT, BY_VOLUME, SHADOW_PASS, VISIBILITY_SHIFT, Paths, Status, note_density, note_receiver
from ..scene.shading_data import SceneData
from ..stages.limits import PathLimits, has_light, survival_of
from ..stages.surface.aim import AimFeatures, make_choose_light
from ..stages.surface.connect_light import make_connect_light
from ..stages.surface.history import DEPTHS
from ..stages.surface.vertex import Vertex
from .features import VolumeFeatures
from .medium import Coefficients, phase_sample, phase_sum
from .table import VolumeData

_RAY_NEW, _ENDED = int(Status.RAY_NEW), int(Status.ENDED)
# The kind of ray that scattering in a volume makes, as objects and programs see it
_SEEN_BY = int(Visibility.VOLUME_SCATTER)


@functools.cache
def make_aim_in_volume(features: VolumeFeatures) -> wp.Function:
    """Function (data, volumes, limits, paths, rays, path: int, v: Vertex, inside: vec4i, throughput: vec3, m:
    Coefficients, lobes: array of PhaseLobe) -> int: looks for light at `v`, for a path of `throughput`; the status bit
    that submits a shadow ray, or 0. `m` and `lobes` are what is there. The throughput of the path is another then.
    """
    choose_light = make_choose_light(narrow(features, AimFeatures))
    connect_light = make_connect_light(narrow(features, type(features).__base__), in_volume=True)

    @wp.func
    def aim_in_volume(
        data: SceneData,
        volumes: VolumeData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        v: Vertex,
        inside: wp.vec4i,
        throughput: wp.vec3,
        m: Coefficients,
        lobes: wp.array(dtype=PhaseLobe),
    ) -> int:
        light = choose_light(data, paths, path, v)
        if not light.pdf > 0.0:
            return 0
        seen = phase_sum(lobes, m, throughput, wp.dot(-v.wo, light.direction))
        value = BsdfValue()
        value.value = seen.value
        value.pdf = seen.pdf
        paths.throughput[path] = throughput
        paths.passed[path] = v.passed + v.passed * wp.static(SHADOW_PASS)
        if paths.shadow_history.shape[0] > 0:
            paths.shadow_history[path] = paths.history[path]
        volumes.state.shadow_inside[path] = inside
        volumes.state.shadow_segment[path] = 0
        return connect_light(data, limits, paths, rays, path, v, light, value)

    return aim_in_volume


@functools.cache
def make_scattered(features: VolumeFeatures) -> wp.Function:
    """Function (volumes, limits, paths, rays, path: int, v: Vertex, throughput: vec3, m: Coefficients, lobes: array of
    PhaseLobe) -> int: scatters a path of `throughput` at `v`, and returns its status. `m` and `lobes` are what is
    there.
    """
    sampler = make_sampler(features.sample_sequence)
    sample_1d = sampler.sample_1d
    sample_3d = sampler.sample_3d

    @wp.func
    def scattered(
        volumes: VolumeData,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        v: Vertex,
        throughput: wp.vec3,
        m: Coefficients,
        lobes: wp.array(dtype=PhaseLobe),
    ) -> int:
        direction = -v.wo
        status = v.status
        u = sample_3d(v.key, v.pixel.sample, v.dimension + wp.uint32(BSDF))
        cosine = phase_sample(lobes, m, throughput, u[2], u[0])
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
                survival = survival_of(limits, carried)
                if sample_1d(v.key, v.pixel.sample, v.dimension + wp.uint32(ROULETTE)) >= survival:
                    goes_on = False
                carried = carried / survival
        if not goes_on:
            return status | wp.static(_ENDED)
        if wp.static(features.splits_light):
            if v.bounce == 0 and paths.passes.shape[0] > 0:
                divide_volume_ray(paths, path)
        if paths.history.shape[0] > 0:
            paths.history[path] = paths.history[path] & wp.static(DEPTHS)
        paths.throughput[path] = carried
        paths.pdf[path] = wp.where(v.pixel.x < limits.nee_end, chosen.pdf, 0.0)
        paths.passed_t[path] = 0.0
        if paths.side.shape[0] > 0:
            paths.side[path] = v.side
        note_receiver(paths, path, v.receiver)
        if paths.cone.shape[0] > 0:
            paths.cone[path] = wp.vec2(0.0, 0.0)
        note_density(paths, path, v.bounce, chosen.pdf)
        if wp.static(features.film_glass):
            paths.clear[path] = wp.uint8(0)
        rays.origin[path] = v.surface.position
        rays.direction[path] = new
        rays.t_max[path] = wp.inf
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(_SEEN_BY)
        status = (status & wp.static((1 << VISIBILITY_SHIFT) - 1)) | wp.static(BY_VOLUME)
        bounce = v.bounce + 1
        if volumes.state.scattered[path] > volumes.bounce_max:
            # the path has been scattered by volumes as often as it may: it finds light alone, as in Cycles
            bounce = wp.max(bounce, limits.bounce_max + 1)
        return status | (bounce << wp.static(BOUNCE_SHIFT)) | wp.static(_RAY_NEW)

    return scattered
