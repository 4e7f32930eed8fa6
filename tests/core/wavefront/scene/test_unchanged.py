"""What a session does again for a scene with the same frozen arrays: nothing of its geometry."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import mesh_tree
from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import ClosureKind, Frame, Image, Material
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.lights import table
from raybatch_addon.core.wavefront.scene import device_scene, kept_inputs, shown_instances
from raybatch_addon.core.wavefront.scene.unchanged import LastSmall
from tests.core.wavefront.scene.keeping import counted_calls, frozen_meshes
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=2)
PIXELS = freeze(np.random.default_rng(3).random((8, 8, 4)).astype(np.float32))


def shining(strength=2.0):
    """A material that emits an image at generated coordinates."""
    builder = ProgramBuilder()
    color, _ = builder.value("image", 0, 1, 0, 0, 0, builder.value("generated", 0))
    builder.closure("emission", builder.value("multiply_colors", color, (strength,) * 3))
    return Material("shining", (), (ClosureKind.EMISSION,), builder.finish())


def seen():
    """A material that emits the distance of the camera's plane."""
    builder = ProgramBuilder()
    _, depth, _, _ = builder.value("camera_coordinates", 0)
    builder.closure("emission", builder.value("splat", depth))
    return Material("seen", (), (ClosureKind.EMISSION,), builder.finish())


def bumped():
    """A material that emits its normal, bent by a height that rises by a centimetre over each pixel, however wide."""
    builder = ProgramBuilder()
    normal, _, _ = builder.value("normals")
    bent = builder.value("bump", 0.0, 0.01, 0.003, 1.0, 1.0, 1.0, normal)
    builder.closure("emission", builder.value("multiply_colors", bent, bent))
    return Material("bumped", (), (ClosureKind.EMISSION,), builder.finish())


def mapped():
    """A material that emits its UV coordinates."""
    builder = ProgramBuilder()
    uv = builder.value("uv", -1, 0)
    builder.closure("emission", builder.value("multiply_colors", uv, (2.0,) * 3))
    return Material("mapped", (), (ClosureKind.EMISSION,), builder.finish())


def with_uvs(scene, seed):
    """`scene`; its first mesh has a UV map of random numbers."""
    box = scene.meshes[0]
    uvs = np.random.default_rng(seed).random((len(box.triangles), 3, 2)).astype(np.float32)
    return frozen_meshes(replace(scene, meshes=(replace(box, corner_uvs=uvs), *scene.meshes[1:])))


def scene_of(material=None, place=0.0):
    made = scenes.scene(
        [
            (scenes.box(), scenes.translation(place, 0, 0), material or shining()),
            (scenes.box(), scenes.translation(0, 3, -2), scenes.diffuse()),
        ],
        view=scenes.camera(eye=(0, -4, 1)),
        frame=Frame(8, 8),
    )
    return replace(made, images=(Image("picture", PIXELS),))


@pytest.fixture
def made(monkeypatch):
    """What was made, by name, in order."""
    calls, count = counted_calls(monkeypatch)
    count(shown_instances, "flatten")
    count(kept_inputs, "upload_inputs")
    count(device_scene, "find_emissive_triangles")
    count(device_scene, "emission_of_triangles")
    count(table, "fill_blocks")
    return calls


def pixels(scene, session=None):
    return (session or Session(DEVICE)).render(scene, SETTINGS).passes["Combined"].tobytes()


EVERYTHING = ["flatten", "upload_inputs", "find_emissive_triangles", "emission_of_triangles", "fill_blocks"]


def test_nothing_is_made_again_of_the_same_arrays(made):
    session, scene = Session(DEVICE), frozen_meshes(scene_of())
    first = pixels(scene, session)
    assert made == EVERYTHING
    # as an exporter has it: other objects, the same arrays
    again = replace(scene, meshes=tuple(replace(mesh) for mesh in scene.meshes), materials=tuple(scene.materials))
    assert pixels(again, session) == first
    assert made == EVERYTHING, "nothing was made again"


def test_arrays_that_may_change_are_looked_at(made):
    session, scene = Session(DEVICE), scene_of()
    first = pixels(scene, session)
    scene.meshes[0].positions[:] *= np.float32(0.5)
    second = pixels(scene, session)
    assert made == 2 * EVERYTHING
    assert second != first and second == pixels(scene)


@pytest.mark.parametrize(
    "change, again",
    [
        ("material", EVERYTHING[2:]),
        ("place", EVERYTHING[1:]),
        ("mesh", EVERYTHING),
        ("image", EVERYTHING[2:]),
        ("camera", []),
        ("camera that is read", EVERYTHING[2:]),
        ("world", []),
        ("lamp", ["fill_blocks"]),
    ],
)
def test_what_changes_is_made_again_and_the_film_is_that_of_a_new_session(made, monkeypatch, change, again):
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 1e9)  # a tree of two boxes may get worse by much
    session, scene = Session(DEVICE), frozen_meshes(scene_of(seen() if change == "camera that is read" else None))
    pixels(scene, session)
    if change == "material":
        other = replace(scene, materials=(shining(3.0), *scene.materials[1:]))
    elif change == "place":
        other = replace(scene, instances=scene_of(place=0.5).instances)
    elif change == "mesh":
        box = scene.meshes[0]
        other = replace(
            scene, meshes=(replace(box, positions=freeze(box.positions * np.float32(0.5))), *scene.meshes[1:])
        )
    elif change == "image":
        other = replace(scene, images=(Image("picture", freeze(PIXELS * np.float32(0.5))),))
    elif change == "lamp":
        other = replace(scene, lights=(scenes.area_light(matrix=scenes.translation(0, -1, 3)),))
    elif change.startswith("camera"):
        other = replace(scene, camera=scenes.camera(eye=(1, -4, 1)))
    else:
        other = replace(scene, world=replace(scene.world, radiance=(0.5, 0.25, 1.0)))
    made.clear()
    film = pixels(other, session)
    assert made == again
    assert film == pixels(other), "as a session renders it that has nothing to keep"


def test_light_that_is_bumped_follows_the_camera(made):
    """Heights are compared over a share of a pixel, whose width depends on the camera."""
    session, scene = Session(DEVICE), frozen_meshes(scene_of(bumped()))
    pixels(scene, session)
    made.clear()
    nearer = replace(scene, camera=scenes.camera(eye=(0, -2, 1)))
    film = pixels(nearer, session)
    again = list(made)
    assert film == pixels(nearer), "as a session renders it that has nothing to keep"
    assert again == EVERYTHING[2:]


def deforming(scene, mesh, way):
    """`scene`; vertices of its mesh number `mesh` move by `way` [m] while the shutter is open, in a new array."""
    still = scene.meshes[mesh].positions
    steps = still + np.linspace(-0.5, 0.5, 3, dtype=np.float32)[:, None, None] * np.float32([way, 0, 0])
    moved = replace(scene.meshes[mesh], motion=steps)
    return replace(scene, meshes=(*scene.meshes[:mesh], moved, *scene.meshes[mesh + 1 :]))


def test_emitters_are_kept_while_other_things_deform(made):
    """An exporter steps through the shutter for each render: what moves is a new array each time."""
    session, scene = Session(DEVICE), frozen_meshes(scene_of())
    pixels(deforming(scene, 1, 0.2), session)
    made.clear()
    other = deforming(scene, 1, 0.4)
    film = pixels(other, session)
    assert "find_emissive_triangles" not in made and "fill_blocks" not in made
    assert film == pixels(other), "as a session renders it that has nothing to keep"


def test_an_emitter_that_begins_to_deform_is_none_any_more(made):
    session, scene = Session(DEVICE), frozen_meshes(scene_of())
    pixels(scene, session)
    other = deforming(scene, 0, 0.2)
    assert pixels(other, session) == pixels(other)


@pytest.mark.parametrize("reads", [True, False])
def test_a_uv_map_counts_where_it_is_read(made, reads):
    session, scene = Session(DEVICE), frozen_meshes(scene_of(mapped() if reads else shining()))
    pixels(with_uvs(scene, 1), session)
    made.clear()
    other = with_uvs(scene, 2)
    film = pixels(other, session)
    assert ("upload_inputs" in made) == reads and ("find_emissive_triangles" in made) == reads
    assert film == pixels(other), "as a session renders it that has nothing to keep"


def test_small_emitters_and_the_choice_among_them_are_kept_while_scenes_take_turns(made):
    """View layers of a frame are rendered one after the other, and again in the next frame."""
    session, scenes_in_turn = Session(DEVICE), [frozen_meshes(scene_of(shining(each))) for each in (2.0, 3.0)]
    films = [pixels(each, session) for each in scenes_in_turn]
    assert films[0] != films[1]
    made.clear()
    assert [pixels(each, session) for each in scenes_in_turn] == films
    assert set(made) == {"flatten", "upload_inputs"}


def test_of_large_things_the_last_alone_is_kept():
    kept, made = LastSmall(len), []

    def get(name, size):
        return kept.get(([], name), lambda: made.append(name) or bytes(size))

    for name in "abab":
        get(name, 8)
    get("large", 2 << 20)
    get("large", 2 << 20)
    assert made == ["a", "b", "large"]
    get("a", 8)
    assert made == ["a", "b", "large"], "small ones lie beside it"
    get("other", 2 << 20)
    get("large", 2 << 20)
    assert made == ["a", "b", "large", "other", "large"]
    for number in range(20):
        get(number, 8)
    get("a", 8)
    assert made[-1] == "a", "so many are not kept"
