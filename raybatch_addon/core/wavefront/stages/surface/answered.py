"""Runs the shader program of a surface with what rays answered to it (`wavefront/requests`)."""

from __future__ import annotations

import functools

import warp as wp

from ....device.codegen.local_arrays import Unset
from ....programs.ops.inputs.ray_inputs import ANSWERS, KNOWN
from ....programs.ops.textures.image_levels import CHANCE, FOOTPRINT
from ....programs.point import ShadingPoint
from ....programs.run import make_run
from ....scene.program import ProgramFeatures
from ....shading.bsdf.materials import ClosureRecord, address_of
from ...rays import Paths
from ...scene.shading_data import SceneData
from .program import with_steps


@wp.func
def give_answers(paths: Paths, path: int, stack: wp.array(dtype=float)):
    """Put what rays answered to a path, all of it, where its program looks; nothing where none are asked for."""
    if paths.answers.shape[0] == 0:
        return
    first = paths.requests[0].first
    count = paths.answers.shape[0] / paths.status.shape[0]
    stack[first + wp.static(KNOWN)] = float(count)
    for k in range(3 * count):
        answer = paths.answers[(k / 3) * paths.status.shape[0] + path]
        stack[first + wp.static(ANSWERS) + k] = answer[k % 3]


@functools.cache
def make_answered_program(features: ProgramFeatures) -> wp.Function:
    """Function (data, paths, path: int, first: int, point, records, width, chance) -> int: `run_filtered` of
    `cone.py`, or `run_surface` of `program.py` where nothing is filtered, with what rays answered.
    """
    run = make_run(features)
    has_levels = "image_level" in features.ops
    has_steps = has_levels or "bump" in features.ops

    @wp.func
    def run_answered(
        data: SceneData,
        paths: Paths,
        path: int,
        first: int,
        point: ShadingPoint,
        records: wp.array(dtype=Unset),
        width: float,
        chance: float,
    ) -> int:
        stack = wp.zeros(wp.static(features.register_count), dtype=float)
        closures = wp.array(ptr=address_of(records), shape=(wp.static(features.closure_count),), dtype=ClosureRecord)
        stepped = point
        if wp.static(has_steps):
            stepped = with_steps(data.nodes, point)
        if wp.static(has_levels):
            cell = wp.dot(stepped.step_x, stepped.step_x) * wp.abs(wp.dot(point.incoming, point.geometric_normal))
            if cell > 0.0:
                stack[wp.static(FOOTPRINT)] = wp.min(width * width / cell, wp.static(3e38))
            stack[wp.static(CHANCE)] = chance
        give_answers(paths, path, stack)
        return run(data.nodes, stack, first, stepped, closures)

    return run_answered
