"""The next request of a surface that a path met, found by a run of the part of its program that asks."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...programs.ops.inputs.ray_inputs import (
    ANSWERS,
    ASKED,
    DISTANCE,
    KNOWN,
    NORMAL,
    ONLY_LOCAL,
    ROUNDED,
    SAMPLES_SHIFT,
)
from ...programs.ops.textures.image_levels import CHANCE, FOOTPRINT
from ...programs.point import ShadingPoint
from ...programs.run import make_run
from ...rays import Rays
from ...scene.geometry import Geometry
from ...scene.program import ProgramFeatures
from ...shading.bsdf.materials import ClosureRecord
from ...shading.segments import is_segment
from ...shading.sequences.keys import TEXTURE
from ...shading.sequences.sampler import make_sampler
from ..rays import Paths, visibility_of
from ..scene.shading_data import SceneData
from ..stages.surface.answered import give_answers
from ..stages.surface.cone import cone_width, path_cone
from ..stages.surface.program import shading_point, with_steps
from ..stages.surface.vertex import Vertex
from .state import Requests

# An edge is not round to a path that has scattered more widely than this [1/sr]: as in Cycles
_DENSITY_LEAST = 8.0


@dataclass(frozen=True)
class AskFeatures:
    """Features that asking is specialised on; the fields are those of `SceneFeatures`."""

    programs: ProgramFeatures
    request_program: ProgramFeatures
    transparency: bool
    path_history: bool
    curves: bool
    sample_sequence: str
    least_density: bool


@wp.func
def is_asked(asked: int, normal: wp.vec3, distance: float) -> bool:
    """Whether a request has rays to trace: whether it is there, and its operands are of use. Nothing is round by a
    radius whose square is beyond float32.
    """
    fits = (asked & ROUNDED) == 0 or distance * distance < wp.inf
    return (asked >> SAMPLES_SHIFT) > 0 and distance > 0.0 and fits and wp.dot(normal, normal) > 0.0


@functools.cache
def make_ask(features: AskFeatures) -> wp.Function:
    """Function (data, requests, paths, rays, path: int, program: int, v: Vertex) -> bool: whether rays have to be
    traced for the surface at `v`, whose requests `program` makes; the request is noted.
    """
    asks = features.request_program
    run = make_run(asks)
    sample_1d = make_sampler(features.sample_sequence).sample_1d
    has_levels = "image_level" in features.programs.ops

    @wp.func
    def point_of(data: SceneData, paths: Paths, rays: Rays, path: int, v: Vertex) -> ShadingPoint:
        length = rays.hit_t[path]
        if wp.static(features.transparency):
            length += paths.passed_t[path]
        point = shading_point(
            v.surface, v.wo, rays.hit_instance[path], rays.hit_primitive[path], rays.hit_uv[path], length
        )
        point.ray_kind = visibility_of(v.status)
        point.bounce = v.bounce
        point.passed = v.passed
        if wp.static(features.path_history):
            point.history = paths.history[path]
        if wp.static(has_levels or "bump" in asks.ops):
            point = with_steps(data.nodes, point)
        return point

    @wp.func
    def is_useful(geometry: Geometry, paths: Paths, rays: Rays, path: int, bounce: int, asked: int) -> bool:
        useful = bool(True)
        if wp.static(features.curves):
            # the object's own curves hide nothing and have no edges
            if (asked & (ROUNDED | ONLY_LOCAL)) != 0:
                mesh = geometry.instance_mesh[rays.hit_instance[path]]
                useful = not is_segment(geometry, geometry.mesh_triangle_first[mesh] + rays.hit_primitive[path])
        if wp.static(features.least_density):
            if (asked & ROUNDED) != 0 and bounce > 0:
                useful = useful and paths.least_density[path] >= _DENSITY_LEAST
        return useful

    @wp.func
    def ask(data: SceneData, requests: Requests, paths: Paths, rays: Rays, path: int, program: int, v: Vertex) -> bool:
        point = point_of(data, paths, rays, path, v)
        stack = wp.zeros(wp.static(asks.register_count), dtype=float)
        closures = wp.zeros(1, dtype=ClosureRecord)
        path_count = paths.status.shape[0]
        known = requests.known[path]
        first = requests.first
        give_answers(paths, path, stack)
        while known < paths.answers.shape[0] / path_count:
            if wp.static(has_levels):
                width = cone_width(path_cone(data.nodes, paths, path, v.bounce), point.ray_length)
                cell = wp.dot(point.step_x, point.step_x) * wp.abs(wp.dot(point.incoming, point.geometric_normal))
                stack[wp.static(FOOTPRINT)] = 0.0
                if cell > 0.0:
                    stack[wp.static(FOOTPRINT)] = wp.min(width * width / cell, wp.static(3e38))
                stack[wp.static(CHANCE)] = sample_1d(v.key, v.pixel.sample, v.dimension + wp.uint32(TEXTURE))
            stack[first + wp.static(KNOWN)] = float(known)
            stack[first + wp.static(ASKED)] = 0.0
            run(data.nodes, stack, program, point, closures)
            asked = int(stack[first + wp.static(ASKED)])
            if asked == 0:
                return False  # the program has no more of them
            normal = wp.vec3(
                stack[first + wp.static(NORMAL)],
                stack[first + wp.static(NORMAL + 1)],
                stack[first + wp.static(NORMAL + 2)],
            )
            distance = stack[first + wp.static(DISTANCE)]
            if is_asked(asked, normal, distance) and is_useful(data.geometry, paths, rays, path, v.bounce, asked):
                requests.known[path] = known
                requests.asked[path] = asked
                requests.normal[path] = wp.normalize(normal)
                requests.distance[path] = distance
                return True
            # as where nobody answers: nothing is occluded, no edge is round
            nothing = wp.vec3(1.0, 0.0, 0.0)
            if (asked & ROUNDED) != 0:
                nothing = wp.vec3(0.0)
            paths.answers[known * path_count + path] = nothing
            stack[first + wp.static(ANSWERS) + 3 * known] = nothing[0]
            stack[first + wp.static(ANSWERS) + 3 * known + 1] = 0.0
            stack[first + wp.static(ANSWERS) + 3 * known + 2] = 0.0
            known += 1
        return False

    return ask
