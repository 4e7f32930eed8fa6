"""Programs that ask for rays: what their requests are, and where the answers lie.

A program with an op of `REQUEST_OPS` is rewritten for a render. Its requests are numbered, and each op gets the
registers in which answers are given, which are the last ones of all programs. What the requests depend on becomes a
program of its own, without closures, which `wavefront/requests` runs until all are answered.
"""

from __future__ import annotations

import dataclasses

from ..scene.description import Scene
from ..scene.program import Instruction, Program, rounded_registers
from ..settings.settings import RenderSettings
from .footprints import filtered_scene
from .ops.inputs.ray_inputs import ANSWERS
from .parts import steps_towards
from .tiling import tiled_scene

REQUEST_OPS = frozenset({"ambient_occlusion", "bevel"})
# Words of these ops: the first register, and the number of the request
_FIRST, _NUMBER = 3, 4


def prepared_scene(scene: Scene, settings: RenderSettings, image_budget: int | None = None) -> Scene:
    """`scene` with the programs of its materials rewritten for a render: images filtered as `settings` say, requests
    for rays numbered, and images in tiles where all take more than `image_budget` bytes (None: there is no limit).

    Raises `OutOfMemoryError` where that is `texture_budget`, and images that cannot be in tiles take more.
    """
    asking = requesting_scene(filtered_scene(scene, settings))
    return tiled_scene(asking, image_budget, settings.texture_tile_bytes, is_asked=settings.texture_budget > 0)


def requesting_scene(scene: Scene) -> Scene:
    """`scene` with the requests of its materials numbered; itself where there are none."""
    programs = {id(m.program): m.program for m in scene.materials if m.program is not None}
    most = max((request_count(program) for program in programs.values()), default=0)
    if most == 0:
        return scene
    used = max(program.register_count for program in programs.values())
    register_count = rounded_registers(used + ANSWERS + 3 * most)
    first = register_count - ANSWERS - 3 * most
    known = {
        key: with_requests(program, most, first, register_count) if request_count(program) else program
        for key, program in programs.items()
    }
    materials = tuple(
        material if material.program is None else dataclasses.replace(material, program=known[id(material.program)])
        for material in scene.materials
    )
    return dataclasses.replace(scene, materials=materials)


def request_count(program: Program) -> int:
    """How often `program` asks for rays."""
    return sum(step.op in REQUEST_OPS for step in program.instructions)


def with_requests(program: Program, most: int, first: int, register_count: int) -> Program:
    """`program` with its requests numbered. `most`: requests of any program; `first`: the first register of answers."""
    number, steps = 0, []
    for step in program.instructions:
        if step.op in REQUEST_OPS:
            words = (*step.words[:_FIRST], first, number, *step.words[_NUMBER + 1 :])
            step, number = Instruction(step.op, words), number + 1
        steps.append(step)
    steps = tuple(steps)
    asks = steps_towards(steps, lambda step: step.op in REQUEST_OPS)
    ops = tuple(sorted({step.op for step in asks}))
    requests = Program(asks, program.constants, register_count, 1, ops, answer_count=most)
    return dataclasses.replace(
        program, instructions=steps, register_count=register_count, answer_count=most, requests=requests
    )
