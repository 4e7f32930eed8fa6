"""Programs: building, folding, encoding, and the interpreter against the values that it was built from."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.programs.table import encode
from raybatch_addon.core.scene.description import ClosureKind, Frame
from raybatch_addon.core.scene.program import Instruction, Program, program_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights.emitters import find_emissive_triangles
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(sample_count=4, bounce_max=3)


def test_constants_are_folded():
    builder = ProgramBuilder()
    product = builder.value("multiply_colors", (1.0, 2.0, 3.0), builder.value("splat", 2.0))
    assert product.constant == (2.0, 4.0, 6.0)
    builder.closure("emission", product)
    (record,) = builder.constant_closures()
    assert record.kind == ClosureKind.EMISSION and tuple(record.weight) == (2.0, 4.0, 6.0)


def test_black_closures_vanish_where_all_is_constant():
    builder = ProgramBuilder()
    builder.closure("emission", (0.0, 0.0, 0.0))
    builder.closure("diffuse", (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert [record.kind for record in builder.constant_closures()] == [ClosureKind.DIFFUSE]


def test_closures_that_a_constant_makes_black_are_not_run_and_change_no_kernel():
    """A Principled BSDF over a texture, without and with emission, metal and glass."""

    def program(strength, metallic, transmission):
        builder = ProgramBuilder()
        weight = builder.value("object_coordinates", 0)
        builder.closure("emission", builder.value("multiply_colors", (strength,) * 3, weight))
        rest, metal = builder.value("mix_weights", weight, metallic)
        builder.closure("diffuse", metal, (0.0, 0.0, 0.0))
        builder.closure("transparent", builder.value("mix_weights", rest, transmission)[1])
        builder.closure("translucent", builder.value("mix_weights", rest, transmission)[0], (0.0, 0.0, 0.0))
        return builder.finish()

    def closures(*values):
        kinds = {"emission", "diffuse", "transparent", "translucent"}
        return {step.op for step in program(*values).instructions} & kinds

    assert closures(1.0, 0.5, 0.5) == {"emission", "diffuse", "transparent", "translucent"}
    assert closures(0.0, 0.0, 0.0) == {"translucent"}
    assert closures(0.0, 0.0, 2.0) == {"transparent"}  # factors are clamped
    assert closures(0.0, 1.0, 0.5) == {"diffuse"}  # nothing is left to share
    assert closures(1e-30, 1e-7, 1e-7) == {"emission", "diffuse", "transparent", "translucent"}
    plain, full = program(0.0, 0.0, 0.0), program(1.0, 0.5, 0.5)
    assert program_features([plain]) == program_features([full]) and plain.ops == full.ops


def test_what_nothing_reads_is_left_out():
    builder = ProgramBuilder()
    position = builder.value("object_coordinates", 0)
    builder.value("luminance", position)
    first, _ = builder.value("mix_weights", position, builder.value("average", position))
    builder.closure("emission", first)
    program = builder.finish()
    assert "luminance" not in program.ops
    (mixed,) = [step for step in program.instructions if step.op == "mix_weights"]
    assert mixed.words[-1] == -1  # its second output


def test_the_same_value_is_computed_once():
    builder = ProgramBuilder()
    a, b = (builder.value("object_coordinates", 0) for _ in range(2))
    assert a is b and builder.value("object_coordinates", 1) is not a


def test_registers_are_shared_along_a_chain():
    builder = ProgramBuilder()
    value = builder.value("object_coordinates", 0)
    for _ in range(500):
        value = builder.value("multiply_colors", value, value)
    builder.closure("emission", value)
    assert builder.finish().register_count <= 9


@pytest.mark.parametrize(
    "instruction",
    [
        Instruction("emission", (1,)),
        Instruction("emission", (-5,)),
        Instruction("emission", ()),
        Instruction("no such op", ()),
    ],
)
def test_programs_that_are_not_valid_are_refused(instruction):
    program = Program((instruction,), np.zeros(3, np.float32), 3, 1, ("emission",))
    with pytest.raises(SceneError):
        encode([program], ("emission",))


def test_a_program_gives_the_picture_of_the_closures_it_makes(session):
    """The pictures are equal bit for bit, next to materials without program."""
    scene = scenes.mixed(Frame(24, 24))
    materials = []
    for material in scene.materials:
        if [closure.kind for closure in material.closures] == [ClosureKind.DIFFUSE]:
            builder = ProgramBuilder()
            builder.closure("diffuse", material.closures[0].weight, (0.0, 0.0, 0.0))
            material = dataclasses.replace(
                material, closures=(), program=builder.finish(), kinds=(ClosureKind.DIFFUSE,)
            )
        materials.append(material)
    assert any(material.program for material in materials) and not all(material.program for material in materials)
    films = [session.render(each, SETTINGS) for each in (scene, dataclasses.replace(scene, materials=tuple(materials)))]
    assert np.array_equal(films[0].passes["Combined"], films[1].passes["Combined"])


def test_sizes_grow_rarely():
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("object_coordinates", 0))
    features = program_features([None, builder.finish()], closure_count=3)
    assert (features.register_count, features.closure_count) == (16, 4)
    assert features.ops == ("emission", "object_coordinates")
    assert Value.of(1.0).known


def test_triangles_whose_program_is_known_to_emit_nothing_are_no_lights():
    for strength, count in ((0.0, 0), (1.0, 2)):
        builder = ProgramBuilder()
        builder.closure("emission", (strength,) * 3)
        builder.closure("diffuse", builder.value("object_coordinates", 0), (0.0, 0.0, 0.0))
        material = dataclasses.replace(
            scenes.diffuse(), closures=(), program=builder.finish(), kinds=(ClosureKind.DIFFUSE, ClosureKind.EMISSION)
        )
        scene = scenes.scene([(scenes.plane(), scenes.IDENTITY, material)])
        found = find_emissive_triangles(scene, lambda instance, primitive: np.ones((len(instance), 3), np.float32))
        assert len(found.primitive) == count


def test_zeros_of_either_sign_are_two_constants():
    """Hashes see the difference."""
    builder = ProgramBuilder()
    plus, minus, again = (builder.value("white_noise", 1, (0.0, 0.0, 0.0), zero)[0] for zero in (0.0, -0.0, 0.0))
    assert plus is again and plus is not minus


def test_what_is_not_finite_is_left_to_the_device():
    builder = ProgramBuilder()
    power = builder.value("math", MathOperation.EXPONENT, 0, 100.0, 0.0, 0.0)
    assert not power.known
    assert builder.value("math", MathOperation.EXPONENT, 0, 1.0, 0.0, 0.0).constant == pytest.approx((np.e,))
