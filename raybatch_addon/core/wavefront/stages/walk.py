"""Stage: a ray below a surface is back, a step of a random walk. Light walks on, or comes out, where `shade_surface`
goes on.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...scene.description import Visibility
from ...shading.bsdf.materials import ClosureRecord
from ...shading.bsdf.subsurface import (
    STEPS_MOST,
    THROUGHPUT_LEAST,
    away_share,
    channel_shares,
    diffusion_length,
    guide_cosine,
    guide_density,
    guide_logarithm,
    length_density,
    medium_of,
    phase_cosine,
    phase_density,
    sampled_length,
    transmittance,
)
from ...shading.sampling import bitangent_of, spherical_direction, tangent_of, to_world
from ...shading.segments import make_surface_point
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import spawn_origin
from ..rays import SHADOW_PASS, Paths, Status, bounce_of, time_of
from ..scene.shading_data import SceneData
from .generate import pixel_sample
from .limits import PathLimits, has_light
from .work import TileWork

_RAY_NEW, _ENDED, _HIT, _INSIDE = int(Status.RAY_NEW), int(Status.ENDED), int(Status.HIT), int(Status.INSIDE)
# Dimension sets of walks: after those of bounces, eight a step, and eight more for the surface where a walk comes out
_FIRST_DIMENSION = 1 << 30
_STEP_DIMENSIONS = 8
_CHANNEL, _LENGTH, _STRATEGY, _SIDE, _DIRECTION = range(5)
# In the first step the far side is looked for as far as this many of the largest mean free path
_FAR = 10.0
# Longer steps leave every scene [m]
_LONGEST = 1e30


@dataclass(frozen=True)
class WalkFeatures:
    """Features that the stage is specialised on; the fields are those of `SceneFeatures`."""

    instancing: bool
    smooth_normals: bool
    curves: bool
    sample_sequence: str
    moving: bool = False


@wp.func
def walk_dimension(surface: int, step: int) -> wp.uint32:
    """The first dimension set of step `step`, from 1, of a walk that begins at surface number `surface` of a path;
    behind those of the last step are the ones of the surface where it comes out."""
    return wp.uint32(wp.static(_FIRST_DIMENSION)) + wp.uint32(
        (surface * wp.static(STEPS_MOST + 1) + step - 1) * wp.static(_STEP_DIMENSIONS)
    )


@wp.func
def first_reach(length: float, extinction: wp.vec3) -> float:
    """How far the first step's ray looks [m]."""
    return wp.max(length, wp.static(_FAR) / wp.min(extinction[0], wp.min(extinction[1], extinction[2])))


@functools.cache
def make_walk_begin(sample_sequence: str) -> wp.Function:
    """Function (paths, rays, path: int, closure, entry: vec3, normal: vec3, throughput: vec3, key, sample, surface:
    int) -> float.

    Begins a walk of throughput `throughput` at `entry`: how far its first ray looks [m]; 0 where nothing goes on.
    """
    sample_1d = make_sampler(sample_sequence).sample_1d

    @wp.func
    def begin(
        paths: Paths,
        rays: Rays,
        path: int,
        closure: ClosureRecord,
        entry: wp.vec3,
        normal: wp.vec3,
        throughput: wp.vec3,
        key: wp.vec2ui,
        sample: wp.uint32,
        surface: int,
    ) -> float:
        extinction = closure.edge
        carried = wp.cw_mul(throughput, closure.refraction)
        if not has_light(carried) or diffusion_length(closure.color) <= 1.0:
            return 0.0
        dimension = walk_dimension(surface, 1)
        u_channel = sample_1d(key, sample, dimension + wp.uint32(wp.static(_CHANNEL)))
        u = sample_1d(key, sample, dimension + wp.uint32(wp.static(_LENGTH)))
        length = sampled_length(extinction, 1.0, channel_shares(carried, closure.color), u_channel, u)
        paths.throughput[path] = carried
        paths.walk.step[path] = 1
        paths.walk.instance[path] = rays.hit_instance[path]
        paths.walk.extinction[path] = extinction
        paths.walk.albedo[path] = closure.color
        paths.walk.g[path] = closure.mean_cosine
        paths.walk.entry[path] = entry
        paths.walk.normal[path] = normal
        paths.walk.length[path] = length
        paths.walk.gone[path] = 0.0
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(int(Visibility.ALL))
        return wp.min(first_reach(length, extinction), wp.static(_LONGEST))

    return begin


@functools.cache
def walk_kernel(features: WalkFeatures) -> wp.Kernel:
    """Kernel (data, work, limits, paths, rays, slots, count): steps that are over. Paths that are not below a surface
    stay as they are.
    """
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sample_1d = sampler.sample_1d
    sample_2d = sampler.sample_2d
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)

    @wp.func
    def scattered(
        work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int, passed: int, position: wp.vec3
    ):
        """The next step, from `position`."""
        step = paths.walk.step[path] + 1
        pixel = pixel_sample(work, paths.item[path])
        key = pixel_key(limits.seed, wp.uint32(pixel.x), wp.uint32(pixel.y), wp.uint32(work.frame_width))
        dimension = walk_dimension(bounce_of(paths.status[path]) + passed, step)
        albedo = paths.walk.albedo[path]
        normal = paths.walk.normal[path]
        direction = rays.direction[path]
        medium = medium_of(paths.walk.extinction[path], albedo, paths.walk.g[path], step)
        diffusion = diffusion_length(albedo)
        stretching = float(1.0)
        u = sample_2d(key, pixel.sample, dimension + wp.uint32(wp.static(_DIRECTION)))
        if sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(_STRATEGY))) < medium.guided:
            cosine = guide_cosine(diffusion, guide_logarithm(diffusion), u[0])
            away = away_share(paths.walk.thickness[path], wp.dot(paths.walk.entry[path] - position, normal), diffusion)
            stretching = 1.0 - cosine / diffusion  # of either side alike
            if sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(_SIDE))) < away:
                cosine = -cosine
            new = to_world(spherical_direction(cosine, wp.TAU * u[1]), tangent_of(normal), bitangent_of(normal), normal)
        else:
            cosine = phase_cosine(medium.g, u[0])
            new = to_world(
                spherical_direction(cosine, wp.TAU * u[1]), tangent_of(direction), bitangent_of(direction), direction
            )
        length = sampled_length(
            medium.extinction,
            stretching,
            channel_shares(paths.throughput[path], albedo),
            sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(_CHANNEL))),
            sample_1d(key, pixel.sample, dimension + wp.uint32(wp.static(_LENGTH))),
        )
        paths.walk.phase[path] = phase_density(medium.g, wp.dot(direction, new))
        paths.walk.step[path] = step
        paths.walk.length[path] = length
        paths.walk.gone[path] = 0.0
        rays.origin[path] = position
        rays.direction[path] = new
        rays.t_max[path] = wp.min(length, wp.static(_LONGEST))

    @wp.kernel(**KERNEL_OPTIONS)
    def walk(
        data: SceneData,
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
        if (status & wp.static(_INSIDE)) == 0:
            return
        step = paths.walk.step[path]
        direction = rays.direction[path]
        gone = paths.walk.gone[path]
        start = rays.origin[path] - gone * direction
        if step == 1:
            # where light goes in, not where the ray begins, which is so far below that it cannot meet the surface: to a
            # medium that is dense beside the size of a triangle that would be a layer in front
            start = paths.walk.entry[path]
        length = paths.walk.length[path]
        extinction = paths.walk.extinction[path]
        albedo = paths.walk.albedo[path]
        normal = paths.walk.normal[path]
        hit = bool(rays.hit_instance[path] >= 0)
        at = float(0.0)
        if hit:
            at = gone + rays.hit_t[path]
            if rays.hit_instance[path] != paths.walk.instance[path]:
                # another object lies inside: the step goes on behind its surface
                hit = False
                reach = length
                if step == 1:
                    reach = first_reach(length, extinction)
                if at < reach:
                    surface = surface_point(
                        data.geometry,
                        rays.hit_instance[path],
                        rays.hit_primitive[path],
                        rays.hit_uv[path],
                        time_of(rays, path),
                    )
                    rays.origin[path] = spawn_origin(
                        surface.position, surface.error, surface.geometric_normal, direction
                    )
                    rays.t_max[path] = wp.min(reach, wp.static(_LONGEST)) - at
                    paths.walk.gone[path] = at
                    paths.status[path] = (status & wp.static(~_HIT)) | wp.static(_RAY_NEW)
                    return
        thickness = float(-1.0)
        if step == 1:
            if hit:
                thickness = wp.max(wp.dot(paths.walk.entry[path] - (start + at * direction), normal), 0.0)
                hit = at < length
            paths.walk.thickness[path] = thickness
        else:
            thickness = paths.walk.thickness[path]
        if hit:
            length = at

        medium = medium_of(extinction, albedo, paths.walk.g[path], step)
        throughput = paths.throughput[path]
        density = length_density(medium.extinction, length, hit)
        if step > 1:
            diffusion = diffusion_length(albedo)
            logarithm = guide_logarithm(diffusion)
            cosine = wp.dot(direction, normal)
            away = away_share(thickness, wp.dot(paths.walk.entry[path] - start, normal), diffusion)
            near = (1.0 - away) * guide_density(diffusion, logarithm, cosine)
            guided = near * length_density((1.0 - cosine / diffusion) * medium.extinction, length, hit)
            if away > 0.0:
                far = away * guide_density(diffusion, logarithm, -cosine)
                guided += far * length_density((1.0 + cosine / diffusion) * medium.extinction, length, hit)
            density = (1.0 - medium.guided) * density + (medium.guided / paths.walk.phase[path]) * guided
        left = transmittance(medium.extinction, length)
        if not hit:
            left = wp.cw_mul(medium.scattering, left)
        likely = wp.dot(channel_shares(throughput, albedo), density)
        throughput = wp.cw_mul(throughput, left) / wp.max(likely, 1.0e-30)
        goes_on = likely > 1.0e-30 and length < wp.static(_LONGEST) and has_light(throughput)
        if hit and goes_on:
            paths.throughput[path] = throughput
            paths.walk.step[path] = 0
            return
        status = status & wp.static(~_HIT)
        most = wp.max(throughput[0], wp.max(throughput[1], throughput[2]))
        if not goes_on or step >= wp.static(STEPS_MOST) or most < wp.static(THROUGHPUT_LEAST):
            paths.status[path] = status | wp.static(_ENDED)
            return
        paths.throughput[path] = throughput
        passed = int(0)
        if paths.passed.shape[0] > 0:
            passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        scattered(work, limits, paths, rays, path, passed, start + length * direction)
        paths.status[path] = status | wp.static(_RAY_NEW)

    return walk
