"""Stage: paths whose rays are back and whose surface has a program that asks for rays. It comes before all others, and
passes on those whose requests are answered.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...film.tile import FilmTile
from ...programs.ops.inputs.ray_inputs import INSIDE, ONLY_LOCAL, ROUNDED, SAMPLES_SHIFT
from ...rays import Rays
from ...scene.description import Visibility
from ...scene.features import narrow
from ...shading.segments import make_surface_point
from ...shading.sequences.sampler import make_sampler
from ...shading.surface import SurfacePoint, spawn_origin
from ..rays import SHADOW_PASS, Paths, Status, bounce_of, time_of
from ..scene.shading_data import SceneData
from ..stages.generate import pixel_sample
from ..stages.limits import PathLimits
from ..stages.surface.vertex import VertexFeatures, make_vertex
from ..stages.work import TileWork
from .ask import AskFeatures, make_ask
from .held import FIRST_DIMENSION, REQUESTS_MOST, give_back, hold, send
from .probes import Probe, edge_probe, edge_weight, occlusion_probe
from .state import Phase, Requests

BELOW = int(Status.INSIDE)
# Surfaces that a ray of an edge counts, and others that any ray passes
_EDGES_MOST = 16
_PASSED_MOST = 4096


@dataclass(frozen=True)
class RequestFeatures(VertexFeatures, AskFeatures):
    """Features that the stage is specialised on; the fields are those of `SceneFeatures`."""


@functools.cache
def make_request(features: RequestFeatures) -> wp.Function:
    """The stage's function, as `stage_kernel` takes it. Paths that wait for answers get a new ray; the others are as
    they were before, with the answers.
    """
    sampler = make_sampler(features.sample_sequence)
    pixel_key = sampler.pixel_key
    sample_2d = sampler.sample_2d
    surface_point = make_surface_point(features.instancing, features.smooth_normals, features.curves, features.moving)
    vertex = make_vertex(narrow(features, VertexFeatures))
    ask = make_ask(narrow(features, AskFeatures))

    @wp.func
    def probe_of(
        requests: Requests, work: TileWork, limits: PathLimits, paths: Paths, path: int, surface: SurfacePoint
    ) -> Probe:
        """The ray of the sample under way."""
        asked = requests.asked[path]
        pixel = pixel_sample(work, paths.item[path])
        key = pixel_key(limits.seed, wp.uint32(pixel.x), wp.uint32(pixel.y), wp.uint32(work.frame_width))
        number = bounce_of(paths.status[path])
        if wp.static(features.transparency):
            number += paths.passed[path] & wp.static(SHADOW_PASS - 1)
        dimension = wp.uint32(wp.static(FIRST_DIMENSION)) + wp.uint32(
            number * wp.static(REQUESTS_MOST) + requests.known[path]
        )
        index = pixel.sample * wp.uint32(asked >> SAMPLES_SHIFT) + wp.uint32(requests.turn[path])
        u = sample_2d(key, index, dimension)
        if (asked & ROUNDED) != 0:
            return edge_probe(surface.position, surface.geometric_normal, requests.distance[path], u)
        normal = requests.normal[path]
        if (asked & INSIDE) != 0:
            normal = -normal
        return occlusion_probe(surface, normal, requests.distance[path], u)

    @wp.func
    def begin(
        requests: Requests, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int, s: SurfacePoint
    ):
        """The next sample, at the surface `s`."""
        probe = probe_of(requests, work, limits, paths, path, s)
        requests.passed[path] = 0
        send(requests, paths, rays, path, probe.origin, probe.direction, probe.length)

    @wp.func
    def note_answer(requests: Requests, paths: Paths, path: int, own: SurfacePoint):
        """What the samples of a request come to."""
        asked = requests.asked[path]
        total = requests.total[path]
        answer = wp.vec3(1.0 - total[0] / float(asked >> SAMPLES_SHIFT), 0.0, 0.0)
        if (asked & ROUNDED) != 0:
            answer = wp.normalize(total)
            if wp.dot(requests.direction[path], own.geometric_normal) > 0.0:
                answer = -answer
        known = requests.known[path]
        paths.answers[known * paths.status.shape[0] + path] = answer
        requests.known[path] = known + 1

    @wp.func
    def goes_on(data: SceneData, requests: Requests, paths: Paths, rays: Rays, path: int, counts: bool) -> bool:
        """Whether the ray goes on behind the surface that it met, which is one that `counts` or another."""
        left = requests.left[path] - rays.hit_t[path]
        passed = requests.passed[path] + 1
        most = int(_PASSED_MOST)
        if counts:
            most = int(_EDGES_MOST)
        if left <= 0.0 or passed >= most:
            return False
        met = surface_point(
            data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
        )
        direction = rays.direction[path]
        requests.passed[path] = passed
        origin = spawn_origin(met.position, met.error, met.geometric_normal, direction)
        send(requests, paths, rays, path, origin, direction, left)
        return True

    @wp.func
    def come_back(
        data: SceneData, requests: Requests, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, path: int
    ) -> bool:
        """A ray of a request is back, and goes on, or that of the next sample begins; False: there are no more."""
        asked = requests.asked[path]
        own = surface_point(
            data.geometry,
            requests.hit_instance[path],
            requests.hit_primitive[path],
            requests.hit_uv[path],
            time_of(rays, path),
        )
        if rays.hit_instance[path] >= 0:
            local = (asked & (ROUNDED | ONLY_LOCAL)) != 0
            counts = bool(not local or rays.hit_instance[path] == requests.hit_instance[path])
            if counts:
                if (asked & ROUNDED) != 0:
                    met = surface_point(
                        data.geometry,
                        rays.hit_instance[path],
                        rays.hit_primitive[path],
                        rays.hit_uv[path],
                        time_of(rays, path),
                    )
                    probe = probe_of(requests, work, limits, paths, path, own)
                    apart = wp.length(met.position - own.position)
                    weight = edge_weight(probe, requests.distance[path], apart, met.geometric_normal)
                    requests.total[path] = requests.total[path] + weight * met.normal
                else:
                    requests.total[path] = requests.total[path] + wp.vec3(1.0, 0.0, 0.0)
            if local and (not counts or (asked & ROUNDED) != 0):
                if goes_on(data, requests, paths, rays, path, counts):
                    return True
        turn = requests.turn[path] + 1
        requests.turn[path] = turn
        if turn < (asked >> SAMPLES_SHIFT):
            begin(requests, work, limits, paths, rays, path, own)
            return True
        note_answer(requests, paths, path, own)
        give_back(requests, paths, rays, path)
        return False

    @wp.func
    def request(
        data: SceneData, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays, film: FilmTile, path: int
    ):
        requests = paths.requests[0]
        if requests.phase[path] == wp.static(int(Phase.PASS)):
            return
        if requests.phase[path] == wp.static(int(Phase.WAITING)):
            if come_back(data, requests, work, limits, paths, rays, path):
                return
        else:
            requests.phase[path] = wp.static(int(Phase.NONE))
            requests.known[path] = 0
        if (paths.status[path] & wp.static(BELOW)) != 0 or rays.hit_instance[path] < 0:
            return
        surface = surface_point(
            data.geometry, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
        )
        # behind the programs of materials are those of their requests
        program = data.nodes.program_first[data.materials.records.shape[0] + surface.material]
        if program < 0:
            return
        v = vertex(data, work, limits, paths, rays, path)
        if not ask(data, requests, paths, rays, path, program, v):
            requests.phase[path] = wp.static(int(Phase.NONE))
            return
        requests.phase[path] = wp.static(int(Phase.WAITING))
        requests.turn[path] = 0
        requests.total[path] = wp.vec3(0.0)
        hold(requests, rays, path)
        if rays.visibility.shape[0] > 0:
            rays.visibility[path] = wp.static(int(Visibility.SHADOW))
            if (requests.asked[path] & (ROUNDED | ONLY_LOCAL)) != 0:
                rays.visibility[path] = wp.static(int(Visibility.ALL))
        begin(requests, work, limits, paths, rays, path, surface)

    return request
