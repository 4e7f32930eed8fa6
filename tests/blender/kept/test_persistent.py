"""Animations with Persistent Data: which meshes are read in which frame; pictures are those of frames alone."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame, sessions
from raybatch_addon.export.meshes import instances, persistent
from tests.support.blender_builders import add_grid, add_triangle, material_of, node_tree

FRAMES = 4


@pytest.fixture
def read(monkeypatch):
    """The objects whose meshes were read, by frame."""
    frames = []

    def begin(job):
        frames.append([])
        persistent.begin_frame(job)

    class Source(instances.MeshSource):
        def __init__(self, mesh, user, warnings):
            frames[-1].append(user)
            super().__init__(mesh, user, warnings)

    monkeypatch.setattr(frame, "begin_frame", begin)
    monkeypatch.setattr(instances, "MeshSource", Source)
    return frames


@pytest.fixture
def films():
    """Pictures of the films."""
    got = []

    def listen(_layer, _scene, film):
        got.append(film.passes["Combined"].copy())

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)


@pytest.fixture
def animated(scene, tmp_path):
    """A grid that stands still, one that waves, a triangle that moves, and one that is there in the last frames."""
    for name, x in (("Still", -0.5), ("Waves", 0.5)):
        grid = add_grid(name, 6)
        grid.location.x = x
        tree, surface = node_tree(material_of(grid))
        emission, place = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "TexCoord"))
        tree.links.new(place.outputs["Generated"], emission.inputs["Color"])
        tree.links.new(emission.outputs[0], surface)
    bpy.data.objects["Waves"].modifiers.new("Wave", "WAVE").height = 0.4
    moves, late = add_triangle("Moves"), add_triangle("Late")
    late.location.z = 1
    for number, x in ((1, 0.0), (FRAMES, 1.0)):
        moves.location.x = x
        moves.keyframe_insert("location", frame=number)
    for number in (1, 3):
        late.hide_render = number == 1
        late.keyframe_insert("hide_render", frame=number)
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.render.filepath = str(tmp_path / "frame")
    scene.render.use_persistent_data = True
    return scene


def test_what_blender_did_not_evaluate_anew_is_not_read_again(animated, read, films):
    bpy.ops.render.render(animation=True)
    assert len(read) == FRAMES and {"Still", "Waves", "Moves"} <= set(read[0])
    for names in read[1:]:
        assert set(names) <= {"Waves", "Late"} and "Waves" in names
    assert "Late" in read[2]
    followed = list(films)
    animated.render.use_persistent_data = False
    for number, picture in enumerate(followed, 1):
        sessions.close_all()
        animated.frame_set(number)
        bpy.ops.render.render()
        assert np.array_equal(films[-1], picture), number
    assert all({"Still", "Waves"} <= set(names) for names in read[FRAMES:]), "nothing tells what changed"


def test_an_edit_between_two_renders_is_seen(animated, read, films):
    bpy.ops.render.render(animation=True)
    for vertex in bpy.data.objects["Still"].data.vertices:
        vertex.co.z += 0.5
    bpy.ops.render.render(animation=True)
    assert "Still" in read[FRAMES]
    assert not np.array_equal(films[0], films[FRAMES])


def test_frames_that_are_stepped_through_are_read_whole(animated, read):
    animated.render.use_motion_blur = True
    bpy.ops.render.render(animation=True)
    assert all("Still" in names for names in read)


def test_a_pass_that_does_not_come_to_its_end_leaves_nothing(animated):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    with pytest.raises(ZeroDivisionError), persistent.known_meshes(depsgraph, False):
        raise ZeroDivisionError
    assert persistent._last is None
