"""Stage: the pass Ambient Occlusion, a ray from each surface that a path meets before it scatters. It comes behind the
stage of requests, whose answers the material needs.

As in Cycles: the ray is distributed as the cosine about the mean normal of diffuse closures, and counts what of the
view ends at the surface, dimmed by transparent surfaces in its way. Volumes do not dim it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...device.codegen.local_arrays import Unset
from ...film.tile import FilmTile
from ...programs.run import make_run
from ...rays import Rays
from ...scene.description import ClosureKind, Visibility
from ...scene.program import ProgramFeatures
from ...shading.bsdf.bsdf import ClosureFeatures, make_bsdf
from ...shading.bsdf.materials import (
    DIFFUSE_KINDS,
    RECORD_FLOATS,
    SURFACE_NORMAL,
    ClosureRecord,
    ShadingFrame,
    address_of,
)
from ...shading.bsdf.normals import make_normals, shading_frame
from ...shading.segments import make_surface_point
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import SurfacePoint, spawn_origin
from ..passes.record import mean_channel
from ..passes.state import add_channels
from ..rays import SHADOW_PASS, Paths, Status, bounce_of, time_of, visibility_of
from ..scene.shading_data import SceneData
from ..stages.generate import pixel_sample
from ..stages.limits import PathLimits, has_light
from ..stages.surface.answered import give_answers
from ..stages.surface.program import fixed_closure_count, fixed_closures, program_of, shading_point, with_steps
from ..stages.work import TileWork
from .held import FIRST_DIMENSION, REQUESTS_MOST, give_back, hold, send
from .probes import occlusion_probe
from .state import Phase, Requests

_ELSEWHERE = int(Status.RAY_NEW | Status.INSIDE)


@dataclass(frozen=True, kw_only=True)
class OcclusionFeatures:
    """Features that the stage is specialised on; the fields are those of `SceneFeatures`."""

    closures: tuple[ClosureKind, ...]
    programs: ProgramFeatures
    transparency: bool
    path_history: bool
    instancing: bool
    smooth_normals: bool
    curves: bool
    sample_sequence: str
    moving: bool = False


@functools.cache
def make_occlusion(features: OcclusionFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it. Paths whose ray is traced for the pass get it; the others are
    as they were before.
    """
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sample_2d = sampler.sample_2d
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    kinds = ClosureFeatures(features.closures)
    transparency = make_bsdf(kinds).transparency
    own_normal = make_normals(kinds.has(ClosureKind.OWN_NORMAL))[1]
    is_diffuse = kinds.test(DIFFUSE_KINDS)
    programs = features.programs
    run = make_run(programs)

    @wp.func
    def run_program(
        data: SceneData,
        paths: Paths,
        rays: Rays,
        path: int,
        program: int,
        surface: SurfacePoint,
        records: wp.array(dtype=Unset),
        is_own: bool,
    ) -> int:
        """Closures where the path's ray, or the one in its place, met `surface`; their number."""
        length = rays.hit_t[path]
        if wp.static(features.transparency):
            length += paths.passed_t[path]
        point = shading_point(
            surface, -rays.direction[path], rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], length
        )
        point.ray_kind = wp.static(int(Visibility.SHADOW))
        if is_own:
            point.ray_kind = visibility_of(paths.status[path])
        if wp.static(features.transparency):
            point.passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        if wp.static(features.path_history):
            point.history = paths.history[path]
        if wp.static("bump" in programs.ops):
            point = with_steps(data.nodes, point)
        stack = wp.zeros(wp.static(programs.register_count), dtype=float)
        if wp.static(programs.answer_count > 0):
            if is_own:
                give_answers(paths, path, stack)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
        return run(data.nodes, stack, program, point, closures)

    @wp.func
    def mean_normal(closures: wp.array(dtype=ClosureRecord), first: int, end: int, frame: ShadingFrame) -> wp.vec3:
        """The normal of the diffuse closures by their weights; without them the surface's."""
        normal = wp.vec3(0.0)
        for c in range(first, end):
            if is_diffuse(closures[c].kind):
                normal += mean_channel(closures[c].weight) * own_normal(closures, c, frame)
        if wp.dot(normal, normal) == 0.0:
            normal = frame.normal
        return wp.normalize(normal)

    @wp.func
    def begin(
        requests: Requests,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        path: int,
        surface: SurfacePoint,
        normal: wp.vec3,
    ):
        """The ray from `surface`."""
        pixel = pixel_sample(work, paths.item[path])
        key = pixel_key(limits.seed, wp.uint32(pixel.x), wp.uint32(pixel.y), wp.uint32(work.frame_width))
        passed = int(0)
        if wp.static(features.transparency):
            passed = paths.passed[path] & wp.static(SHADOW_PASS - 1)
        dimension = wp.uint32(wp.static(FIRST_DIMENSION)) + wp.uint32(
            passed * wp.static(REQUESTS_MOST) + wp.static(REQUESTS_MOST - 1)
        )
        u = sample_2d(key, pixel.sample, dimension)
        probe = occlusion_probe(surface, normal, paths.passes[0].inputs.occlusion_distance, u)
        hold(requests, rays, path)
        requests.phase[path] = wp.static(int(Phase.PASS))
        requests.passed[path] = passed
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(int(Visibility.SHADOW))
        send(requests, paths, rays, path, probe.origin, probe.direction, probe.length)

    @wp.func
    def goes_on(
        requests: Requests, limits: PathLimits, paths: Paths, rays: Rays, path: int, surface: SurfacePoint
    ) -> bool:
        """Whether the ray of the pass goes on behind `surface`."""
        left = requests.left[path] - rays.hit_t[path]
        passed = requests.passed[path] + 1
        if not has_light(requests.total[path]) or passed > limits.transparent_bounce_max or left <= 0.0:
            return False
        requests.passed[path] = passed
        direction = rays.direction[path]
        origin = spawn_origin(surface.position, surface.error, surface.geometric_normal, direction)
        send(requests, paths, rays, path, origin, direction, left)
        return True

    @wp.func
    def occlusion(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        requests = paths.requests[0]
        status = paths.status[path]
        if (status & wp.static(_ELSEWHERE)) != 0 or bounce_of(status) > 0:
            return
        is_own = bool(requests.phase[path] != wp.static(int(Phase.PASS)))
        if rays.hit_instance[path] < 0:
            if not is_own:
                passes = paths.passes[0]
                add_channels(passes, passes.occlusion, path, requests.total[path])
                requests.phase[path] = wp.static(int(Phase.NONE))
                give_back(requests, paths, rays, path)
            return
        surface = surface_point(
            data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
        )
        frame = shading_frame(surface, -rays.direction[path])
        if wp.static(bool(programs)):
            records = wp.zeros(wp.static(programs.closure_count * RECORD_FLOATS), dtype=Unset)
            address = fixed_closures(data, surface.material)
            first = int(0)
            end = fixed_closure_count(data, surface.material)
            program = program_of(data, surface.material)
            if program >= 0:
                end = run_program(data, paths, rays, path, program, surface, records, is_own)
                address = address_of(records)
            closures = wp.array(ptr=address, shape=(wp.static(programs.closure_count),), dtype=ClosureRecord)
            if wp.static("surface_normal" in programs.ops):
                if end > 0 and closures[0].kind == wp.static(SURFACE_NORMAL):
                    frame.normal = closures[0].normal
        else:
            closures = data.materials.closures
            first = data.materials.records[surface.material].closure_first
            end = data.materials.records[surface.material].closure_end
        through = wp.vec3(0.0)
        if wp.static(features.transparency):
            through = transparency(closures, first, end)
        if is_own:
            seen = wp.vec3(0.0)
            for c in range(3):
                seen[c] = paths.throughput[path][c] * wp.clamp(1.0 - through[c], 0.0, 1.0)
            if has_light(seen):
                requests.total[path] = seen
                normal = mean_normal(closures, first, end, frame)
                begin(requests, work, limits, paths, rays, path, surface, normal)
            return
        requests.total[path] = wp.cw_mul(requests.total[path], through)
        if not goes_on(requests, limits, paths, rays, path, surface):
            requests.phase[path] = wp.static(int(Phase.NONE))
            give_back(requests, paths, rays, path)

    return occlusion
