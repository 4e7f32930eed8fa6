"""Programs that ask for rays: their requests are numbered, and what they depend on is a program of its own."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.op import as_python, op_named
from raybatch_addon.core.programs.ops.inputs.ray_inputs import ANSWERS, ROUNDED, SAMPLES_SHIFT
from raybatch_addon.core.programs.requests import REQUEST_OPS, prepared_scene, request_count
from raybatch_addon.core.scene.description import ClosureKind, Material
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.program import Program
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import bytes_per_path
from raybatch_addon.core.wavefront.requests.state import request_bytes_per_path
from raybatch_addon.core.wavefront.tier import why_not_general
from tests.support import scenes

SETTINGS = RenderSettings()
_FOUR = 4 << SAMPLES_SHIFT


def nested() -> Program:
    """Occlusion about a rounded normal, as a colour beside a texture that no request depends on."""
    builder = ProgramBuilder()
    rounded = builder.value("bevel", builder.value("normals")[0], 0.1, ROUNDED | _FOUR, -1, -1)
    seen = builder.value("ambient_occlusion", rounded, 2.0, _FOUR, -1, -1)
    elsewhere = builder.value("multiply_colors", builder.value("position", 0), builder.value("splat", seen))
    builder.closure("emission", elsewhere)
    return builder.finish()


def scene_of(*programs: Program | None):
    ball = scenes.sphere(segments=8, rings=4)
    kinds = (ClosureKind.EMISSION,)
    objects = [(ball, scenes.translation(i, 0, 0), Material(f"m{i}", (), kinds, p)) for i, p in enumerate(programs)]
    return scenes.scene(objects, view=scenes.camera())


def plain() -> Program:
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("position", 0))
    return builder.finish()


def steps(program: Program):
    return {step.op: step.words for step in program.instructions}


def test_requests_are_numbered_in_the_order_of_the_program():
    program = prepared_scene(scene_of(nested()), SETTINGS).materials[0].program
    first = program.register_count - ANSWERS - 6
    assert steps(program)["bevel"][3:5] == (first, 0) and steps(program)["ambient_occlusion"][3:5] == (first, 1)
    assert program.answer_count == 2 and request_count(program) == 2


def test_what_requests_depend_on_is_a_program_without_closures():
    program = prepared_scene(scene_of(nested()), SETTINGS).materials[0].program
    assert [step.op for step in program.requests.instructions] == ["normals", "bevel", "ambient_occlusion"]
    assert set(program.requests.ops) == {"normals", *REQUEST_OPS}
    np.testing.assert_array_equal(program.requests.constants, program.constants)


def test_registers_of_answers_are_the_same_for_all_programs_and_free_in_all():
    prepared = prepared_scene(scene_of(nested(), plain()), SETTINGS)
    features = derive_features(prepared, SETTINGS)
    first = features.programs.register_count - ANSWERS - 3 * features.programs.answer_count
    for material in prepared.materials:
        for step in material.program.instructions:
            for letter, word in zip(op_named(step.op).signature, step.words):
                assert letter not in "nvNV" or word + (3 if letter in "vV" else 1) <= first
    assert features.request_program.register_count == features.programs.register_count
    assert features.requests and features.least_density


def test_a_scene_without_requests_stays_as_it_is():
    scene = scene_of(plain(), None)
    assert prepared_scene(scene, SETTINGS) is scene
    features = derive_features(scene, SETTINGS)
    assert not features.requests and "rays for programs" in features.left_out()
    assert request_bytes_per_path(features) == 0 and not features.least_density
    assert why_not_general(features, wp.get_device("cpu")) == ""


def test_memory_of_a_path_grows_by_its_state_and_answers():
    scene = prepared_scene(scene_of(nested()), SETTINGS)
    features = derive_features(scene, SETTINGS)
    without = derive_features(scene_of(plain()), SETTINGS)
    grown = bytes_per_path(features) - bytes_per_path(without)
    assert grown == request_bytes_per_path(features) + 2 * 12 + 4  # and the least density, for edges


@pytest.mark.parametrize("name", sorted(REQUEST_OPS))
def test_where_nobody_answers_nothing_is_occluded_and_no_edge_is_round(name):
    """On the host, as where light is aimed at: the op's own words say that nobody answers."""
    constants = [0.0, 0.0, -1.0, 1.0]
    data = SimpleNamespace(code=[0, -1, -4, _FOUR, -1, -1, 0], constants=constants)
    stack = [7.0] * 3
    as_python(op_named(name).function)(data, stack, 0, None)
    assert stack == ([1.0, 7.0, 7.0] if name == "ambient_occlusion" else constants[:3])
