"""Programs with footprints: which look-ups choose a level, and that all else stays as it was."""

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.footprints import LEVEL_OPS, filtered_scene, with_footprints
from raybatch_addon.core.programs.op import op_named
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.programs.ops.textures.image_levels import REGISTERS
from raybatch_addon.core.scene.description import ClosureKind, Image, Material
from raybatch_addon.core.scene.program import Program
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.levels import ImageLevels
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from tests.support import scenes

FILTERED = RenderSettings(texture_filter="FOOTPRINT")


def looked_up(builder, coordinates, image=0, divide=0):
    return builder.value("image", image, Interpolation.LINEAR, Extension.REPEAT, Projection.FLAT, divide, coordinates)[
        0
    ]


def program_of(make) -> Program:
    builder = ProgramBuilder()
    builder.closure("emission", make(builder))
    return builder.finish()


def steps(program: Program, name: str):
    return [step for step in program.instructions if step.op == name]


def shifts(program: Program, name: str) -> list[int]:
    place = op_named(name).signature.index("s")
    return sorted(step.words[place] for step in steps(program, name))


def scaled(builder, coordinates):
    return builder.value("affine", 0, coordinates, (2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, 0.0))


def test_coordinates_are_made_thrice_one_step_aside_along_either_axis():
    program = program_of(lambda b: looked_up(b, scaled(b, b.value("uv", -1, 0))))
    filtered = with_footprints(program, 1.0)
    assert shifts(filtered, "uv") == [0, 1, 2] and len(steps(filtered, "affine")) == 3
    assert len(steps(filtered, "image_level")) == len(steps(filtered, "image_at")) == 1
    assert not steps(filtered, "image") and set(LEVEL_OPS) <= set(filtered.ops)
    assert filtered.register_count > program.register_count


def test_registers_in_front_are_left_free():
    filtered = with_footprints(program_of(lambda b: looked_up(b, b.value("uv", -1, 0))), 1.0)
    for step in filtered.instructions:
        for letter, word in zip(op_named(step.op).signature, step.words):
            width = 3 if letter in "vV" else 1
            if letter in "nvNV" and word >= 0:
                assert REGISTERS <= word <= filtered.register_count - width


def test_two_look_ups_of_the_same_coordinates_share_their_steps():
    def make(builder):
        coordinates = builder.value("uv", -1, 0)
        first, second = looked_up(builder, coordinates), looked_up(builder, coordinates, image=1)
        return builder.value("multiply_colors", first, second)

    filtered = with_footprints(program_of(make), 1.0)
    assert shifts(filtered, "uv") == [0, 1, 2] and len(steps(filtered, "image_level")) == 2


def test_a_normal_map_stays_at_level_0():
    builder = ProgramBuilder()
    coordinates = builder.value("uv", -1, 0)
    normal = builder.value("normal_map", 0, -1, looked_up(builder, coordinates, image=1), 1.0)
    builder.closure("diffuse", looked_up(builder, coordinates, image=2), normal)
    filtered = with_footprints(builder.finish(), 1.0)
    assert {step.words[0] for step in steps(filtered, "image_at")} == {2}
    assert {step.words[0] for step in steps(filtered, "image")} == {1}


def test_heights_of_bump_mapping_stay_at_level_0():
    builder = ProgramBuilder()
    heights = [builder.value("average", looked_up(builder, builder.value("uv", -1, shift))) for shift in (0, 1, 2)]
    normal = builder.value("bump", *heights, 1.0, 1.0, 1.0, builder.value("normals")[0])
    builder.closure("diffuse", looked_up(builder, builder.value("uv", -1, 0), image=2), normal)
    filtered = with_footprints(builder.finish(), 1.0)
    assert {step.words[0] for step in steps(filtered, "image_at")} == {2}
    assert len(steps(filtered, "image")) == 3


@pytest.mark.parametrize(
    "coordinates",
    [
        lambda b: b.value("reflection"),  # does not follow the surface
        lambda b: (0.25, 0.5, 0.0),
        lambda b: looked_up(b, b.value("uv", -1, 0)),  # read from a texture
    ],
    ids=["direction", "constant", "texture"],
)
def test_other_look_ups_stay_at_level_0(coordinates):
    program = program_of(lambda b: looked_up(b, coordinates(b), image=5))
    filtered = with_footprints(program, 1.0)
    (step,) = steps(filtered, "image")
    assert step.words[0] == 5


def test_a_program_without_images_is_the_same_object():
    program = program_of(lambda b: b.value("position", 0))
    assert with_footprints(program, 1.0) is program


def test_the_constants_of_tables_keep_their_places():
    table = tuple(np.linspace(0, 1, 7))

    def make(builder):
        builder.table(table)
        return looked_up(builder, builder.value("uv", -1, 0))

    program = program_of(make)
    assert np.array_equal(with_footprints(program, 1.0).constants[: len(program.constants)], program.constants)


def scene_with(*programs, images=3):
    made = scenes.scene()
    materials = tuple(Material(f"{i}", (), (ClosureKind.EMISSION,), each) for i, each in enumerate(programs))
    pixels = np.zeros((4, 4, 4), np.uint8)
    return type(made)(
        camera=made.camera, frame=made.frame, materials=materials, images=(Image("image", pixels),) * images
    )


def test_off_leaves_the_scene_alone():
    scene = scene_with(program_of(lambda b: looked_up(b, b.value("uv", -1, 0))))
    assert filtered_scene(scene, RenderSettings()) is scene


def test_images_have_levels_where_a_look_up_asks_for_them():
    plain = program_of(lambda b: looked_up(b, b.value("uv", -1, 0)))
    divided = program_of(lambda b: looked_up(b, b.value("uv", -1, 0), image=2, divide=1))
    by_direction = program_of(lambda b: looked_up(b, b.value("reflection"), image=1))
    scene = filtered_scene(scene_with(plain, divided, by_direction), FILTERED)
    levels = [getattr(image, "levels", ImageLevels.NONE) for image in scene.images]
    assert levels == [ImageLevels.PLAIN, ImageLevels.NONE, ImageLevels.DIVIDED]
