"""Renders with Persistent Data, where Blender keeps the engine from frame to frame and from render to render."""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame, reports, sessions
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from tests.support.blender_builders import add_triangle
from tests.support.blender_watch import watch_engines


@pytest.fixture
def kept(scene):
    """A scene under a light, with Persistent Data."""
    scene.world = bpy.data.worlds.new("World")
    scene.render.use_persistent_data = True
    return scene


@pytest.fixture
def films():
    """(frame, film) of all renders."""
    got = []

    def listen(_layer, _scene, film):
        got.append((reports.last().frame, film))

    frame.film_listeners.append(listen)
    yield got
    frame.film_listeners.remove(listen)


def test_each_frame_and_each_render_has_a_report_of_its_own(kept, films, tmp_path):
    kept.render.filepath = f"{tmp_path}/"
    kept.raybatch.sample_count = 1
    kept.frame_start, kept.frame_end = 1, 2
    bpy.ops.render.render(animation=True)
    assert [number for number, _ in films] == [1, 2]
    kept.camera.scale.x = 0.0
    with pytest.raises(RuntimeError, match="Camera"):
        bpy.ops.render.render()
    kept.camera.scale.x = 1.0
    bpy.ops.render.render()
    assert len(films) == 3 and reports.last().errors == []


@pytest.mark.parametrize("meanwhile", ["export", "build"])
def test_a_cancel_between_two_frames_leaves_the_session_as_it_was(kept, films, monkeypatch, meanwhile):
    """Blender tells of Esc by `test_break`: while the second frame is read or built, it ends at once, with no film, and
    what is rendered afterwards has the bits of a new session.
    """
    stone = add_triangle("Stone")
    for number, x in ((1, -1.0), (3, 1.0)):
        stone.location = (x, 0, 0.5)
        stone.keyframe_insert("location", frame=number)
    is_pressed = []
    watch_engines(monkeypatch, test_break=lambda _engine: bool(is_pressed))
    begin, get = frame.begin_frame, SceneCache.get

    def press_in_second(part):
        if part == meanwhile and kept.frame_current == 2:
            is_pressed.append(1)

    monkeypatch.setattr(frame, "begin_frame", lambda job: (press_in_second("export"), begin(job))[1])
    monkeypatch.setattr(SceneCache, "get", lambda *of: (press_in_second("build"), get(*of))[1])
    sessions.close_all()

    def render_frames(*numbers):
        for number in numbers:
            kept.frame_set(number)
            bpy.ops.render.render()

    render_frames(1, 2)
    assert [(number, film.complete) for number, film in films if film.sample_total] == [(1, True)]
    assert is_pressed and reports.last().errors == []
    films.clear()
    is_pressed.clear()
    monkeypatch.setattr(frame, "begin_frame", begin)
    monkeypatch.setattr(SceneCache, "get", get)
    render_frames(2, 3, 2)
    sessions.close_all()
    render_frames(2, 3)
    pictures = [film.passes["Combined"].tobytes() for _, film in films]
    assert pictures[:3] == [pictures[3], pictures[4], pictures[3]] and pictures[3] != pictures[4]
    assert all(film.complete for _, film in films)
