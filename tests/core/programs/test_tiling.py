"""Programs whose images are in tiles, and their parts that fetch."""

import dataclasses

import pytest

from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.programs.op import op_named, op_names, op_numbers
from raybatch_addon.core.programs.tiling import (
    TILED_OPS,
    WANT_OPS,
    fetch_part,
    held_images,
    images_of_displacement,
    tiled_scene,
    tiles_at_once,
)
from raybatch_addon.core.scene.description import ClosureKind, Scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.passes import OCCLUSION_PASS
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.image_upload import device_bytes_of
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.core.shading.images.tiled.pictures import TiledImage
from raybatch_addon.core.wavefront.rays import bytes_per_path
from tests.support.images.textured_scenes import BYTES, COLORS, GREYS, LEAVES, TILES, room, sky

SLOT, BUDGET = 1024, 150_000


def program_of(scene: Scene, name: str):
    return next(m.program for m in scene.materials if m.name == name)


def names_of(program) -> list[str]:
    return [step.op for step in program.instructions]


def test_a_scene_that_fits_is_as_it_was():
    scene = room()
    assert tiled_scene(scene, None, SLOT) is scene
    assert tiled_scene(scene, device_bytes_of(scene.images), SLOT) is scene
    assert not derive_features(scene, RenderSettings()).fetch_program


def test_look_ups_find_tiles_and_what_they_need_is_asked_for_before():
    scene = tiled_scene(room(), BUDGET, SLOT)
    assert all(isinstance(image, TiledImage) for image in scene.images)
    for material in scene.materials:
        if material.program is not None:
            names = names_of(material.program)
            assert "image" not in names and not WANT_OPS & set(names)
            assert material.program.fetches.closure_count == 0
    leaf = program_of(scene, "leaf")
    assert names_of(leaf.fetches) == ["uv", "tiled_want"]
    features = derive_features(scene, RenderSettings())
    assert set(features.fetch_program.ops) <= set(features.programs.ops) | WANT_OPS
    assert {m.program.fetches.register_count for m in scene.materials if m.program} == {
        features.fetch_program.register_count
    }
    assert bytes_per_path(features) > bytes_per_path(derive_features(room(), RenderSettings()))


def test_coordinates_that_are_looked_up_are_waited_for():
    fetches = program_of(tiled_scene(room(), BUDGET, SLOT), "distorted").fetches
    wants = [step for step in fetches.instructions if step.op in WANT_OPS]
    at = {"tiled_want": 4, "tiled_want_box": 3}
    assert [step.words[at[step.op]] for step in wants] == [0, 1, 1]  # whether they depend on others
    sure = {"tiled_image": 5, "tiled_image_box": 4}
    assert all(step.words[sure[step.op]] == 0 for step in fetches.instructions if step.op in TILED_OPS)
    whole = program_of(tiled_scene(room(), BUDGET, SLOT), "distorted")
    assert all(step.words[sure[step.op]] == 1 for step in whole.instructions if step.op in TILED_OPS)


@pytest.mark.parametrize("interpolation, across", list(zip(Interpolation, (1, 2, 3))))
def test_tiles_that_a_path_needs_at_once_are_bounded(interpolation, across):
    scene = tiled_scene(room(interpolation, Extension.MIRROR), BUDGET, SLOT)
    programs = [m.program.fetches for m in scene.materials if m.program]
    assert tiles_at_once([None]) == 0
    assert tiles_at_once(programs) == 2 * 4 + 3 * 4  # two flat look-ups and one along three axes, linear
    assert tiles_at_once([program_of(scene, "plain").fetches]) == across * across


def test_small_pictures_are_whole():
    scene = tiled_scene(room(), 400_000, 1 << 16)
    kinds = [isinstance(image, TiledImage) for image in scene.images]
    assert kinds == [True, True, True, False, False]
    assert device_bytes_of([scene.images[BYTES]]) <= 1 << 16 and "image" in names_of(program_of(scene, "distorted"))


def test_images_of_those_who_cannot_wait_are_held():
    scene = dataclasses.replace(room(), world=sky())
    assert held_images(scene) == {COLORS: "the world"}
    passes = dataclasses.replace(scene.frame, passes=("Combined", OCCLUSION_PASS))
    assert held_images(dataclasses.replace(scene, frame=passes)).keys() == {COLORS, GREYS, LEAVES, TILES, BYTES}
    shining = tuple(
        dataclasses.replace(m, program=dataclasses.replace(m.program, instructions=_emitting(m.program)))
        if m.name == "leaf"
        else m
        for m in scene.materials
    )
    found = held_images(dataclasses.replace(room(), materials=shining))
    assert found == {LEAVES: "a material that emits"}


def _emitting(program):
    diffuse = next(step for step in program.instructions if step.op == "diffuse")
    emission = dataclasses.replace(diffuse, op="emission", words=diffuse.words[:1])
    return (*program.instructions, emission)


def test_what_is_held_and_does_not_fit_is_named_or_refused():
    scene = dataclasses.replace(room(), world=sky())
    (warning,) = tiled_scene(scene, BUDGET, SLOT).warnings
    assert "“colors”, of the world" in warning and warning.remedy
    with pytest.raises(OutOfMemoryError, match=r"texture_budget is 150,000 bytes, .* needs [\d,]+ at least.*“colors”"):
        tiled_scene(scene, BUDGET, SLOT, is_asked=True)


def test_what_nobody_looks_up_has_no_pixels():
    scene = room()
    bare = dataclasses.replace(scene, materials=tuple(m for m in scene.materials if m.name in ("leaf", "mirror")))
    kept = [image.pixels is not None or image.tiles is not None for image in tiled_scene(bare, 10_000, SLOT).images]
    assert kept == [False, False, True, False, False]
    nobody = tiled_scene(dataclasses.replace(scene, materials=()), 10_000, SLOT)
    assert device_bytes_of(nobody.images) == 0 and nobody.warnings == scene.warnings


def test_displacement_gets_its_own_images_alone():
    scene = room()
    moved = dataclasses.replace(
        scene, materials=(dataclasses.replace(scene.materials[0], displacement=scene.materials[0].program),)
    )
    found = images_of_displacement(moved, BUDGET)
    assert [image.pixels is not None for image in found] == [True, False, False, False, False]
    assert images_of_displacement(moved, None) is moved.images


def test_a_program_without_tiles_has_no_part_that_fetches():
    assert fetch_part(program_of(room(), "leaf"), 32) is None


def test_ops_of_tiles_leave_the_numbers_of_all_others_alone():
    names = op_names()
    tiled = [name for name in names if name.startswith("tiled_")]
    assert set(tiled) == TILED_OPS | WANT_OPS and names[-len(tiled) :] == tiled
    assert not any(op_named(name).general for name in tiled) and max(op_numbers().values()) == len(names)


def test_materials_that_only_scatter_wait():
    assert ClosureKind.EMISSION not in room().materials[0].kinds and held_images(room()) == {}
