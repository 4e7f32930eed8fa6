"""Final renders in Blender with checkpoints: where they are, what goes on from them, and what begins anew."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from tests.support.command_line import error_line
from tests.support.scripts_here import call_script

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import checkpoints, frame, reports
from raybatch_addon.core.checkpoint.file import load_kept
from raybatch_addon.core.wavefront.render import rendering
from raybatch_addon.ui.checkpoint import RAYBATCH_RENDER_PT_checkpoint
from tests.support.panel_layout import context_of, drawn


@pytest.fixture
def kept(scene, tmp_path):
    """A scene with a checkpoint, to be rendered to `tmp_path`/out0001.png."""
    bpy.ops.mesh.primitive_cube_add(size=2)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.2, 0.4, 0.6)
    scene.render.filepath = str(tmp_path / "out")
    scene.frame_set(1)
    scene.raybatch_checkpoint.use = True
    return scene


@pytest.fixture
def path(kept, tmp_path):
    return tmp_path / "out0001.untitled.checkpoint"


def render() -> dict:
    """The statistics of the first view layer."""
    bpy.ops.render.render()
    return statistics()


def statistics() -> dict:
    return next(iter(reports.last().statistics.values()))


def render_stopped(monkeypatch, looks: int = 100) -> dict:
    """A render that is told to stop when it has asked so often."""
    left = [looks]

    def is_asked():
        left[0] -= 1
        return left[0] < 0

    with monkeypatch.context() as patch:
        patch.setattr(rendering, "POLL_SECONDS", 0.001)
        patch.setattr(frame, "stop_listeners", [is_asked])
        with pytest.raises(RuntimeError, match="stopped from the keyboard"):
            render()
    assert reports.last().interrupted
    return statistics()


def pixels() -> np.ndarray:
    found = []
    frame.film_listeners.append(lambda layer, scene, film: found.append(film.passes["Combined"]))
    try:
        render()
    finally:
        frame.film_listeners.pop()
    return found[0]


def test_a_stopped_render_goes_on_when_it_is_started_again(kept, path, monkeypatch):
    kept.raybatch.sample_count = 1_000_000
    notes = []
    monkeypatch.setattr(frame, "note_listeners", [notes.append])
    reported = render_stopped(monkeypatch)
    assert not reported["complete"] and reported["checkpoint"]["file"] == str(path)
    assert notes == [f"stopped; the same render goes on from {path}"]
    samples = load_kept(path).film().sample_total
    again = render_stopped(monkeypatch)
    assert again["samples"] > samples == reported["samples"] and again["checkpoint"]["samples_before"] > 0
    assert notes[1].startswith(f"goes on from {path}: ")


def test_more_samples_are_added_and_the_picture_is_that_of_one_render(kept, path):
    render()
    kept.raybatch.sample_count = 5
    picture = pixels()
    reported = next(iter(reports.last().statistics.values()))
    assert reported["checkpoint"]["samples_before"] == 2 and reported["complete"]
    kept.raybatch_checkpoint.use = False
    assert np.array_equal(picture, pixels())
    assert next(iter(reports.last().statistics.values()))["checkpoint"] is None


def test_a_finished_film_fills_the_picture(kept, path, tmp_path):
    """Nothing is rendered, and Blender has all pixels."""
    for name in "ab":
        kept.render.filepath = str(tmp_path / "out")
        bpy.ops.render.render()
        bpy.data.images["Render Result"].save_render(str(tmp_path / f"{name}.png"))
    assert next(iter(reports.last().statistics.values()))["rays"]["total"] == 0
    first, second = (np.array(Image.open(tmp_path / f"{name}.png")) for name in "ab")
    assert np.array_equal(first, second) and first.std() > 0


def test_another_scene_begins_anew_and_keeps_what_was_unfinished(kept, path, monkeypatch):
    kept.raybatch.sample_count = 1_000_000
    render_stopped(monkeypatch)
    kept.camera.location.x += 0.5
    kept.raybatch.sample_count = 2
    reported = render()
    assert reported["complete"] and reported["checkpoint"]["samples_before"] == 0
    assert "the render begins anew (the old file is now out0001.untitled.checkpoint.old)" in reports.last().warnings[0]
    assert load_kept(path.with_name(f"{path.name}.old")).identity.settings["sample_count"] == 1_000_000


def test_layers_have_files_of_their_own(kept, tmp_path):
    kept.view_layers.new("Second/layer")
    bpy.ops.render.render()
    names = sorted(each.name for each in tmp_path.iterdir())
    assert names == ["out0001.untitled.Second_layer.checkpoint", "out0001.untitled.ViewLayer.checkpoint"]


def test_movies_have_a_file_a_frame(kept, tmp_path):
    image = kept.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "VIDEO"
    image.file_format = "FFMPEG"
    kept.frame_set(7)
    assert checkpoints.checkpoint_path(kept, "ViewLayer").name.endswith(".0007.untitled.checkpoint")


def test_a_file_that_cannot_be_written_is_a_warning(kept, tmp_path):
    (tmp_path / "file").write_text("no folder")
    kept.render.filepath = str(tmp_path / "file" / "out")
    reported = render()
    assert reported["complete"] and "could not be written" in reported["warnings"][0]
    assert any("could not be written" in text for text in reports.last().warnings)


def test_the_panel_says_where_the_file_is(kept, path):
    texts = " ".join(note[1] for note in drawn(RAYBATCH_RENDER_PT_checkpoint, context_of(kept)) if note[0] == "label")
    assert "Kept as" in texts and path.name in texts, "the name is not broken"
    render()
    texts = " ".join(note[1] for note in drawn(RAYBATCH_RENDER_PT_checkpoint, context_of(kept)) if note[0] == "label")
    assert "The next render goes on from" in texts


def test_frames_of_a_command_have_files_of_their_own(kept, tmp_path, addon):
    kept.raybatch_checkpoint.use = False
    blend, report = tmp_path / "a.blend", tmp_path / "a.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    arguments = (blend, "--frames", "3..4", "--device", "cpu", "--checkpoint", tmp_path / "f.checkpoint")
    done = call_script("render.py", *arguments)
    assert done.returncode == 0, done.stderr
    files = [tmp_path / f"f{number:04d}.checkpoint" for number in (3, 4)]
    assert all(load_kept(each).progress.done == 2 for each in files)
    done = call_script("render.py", *arguments, "--set", "sample_count=3", "--json", report)
    assert done.returncode == 0 and done.stderr.count("2 of 3 samples are there") == 2
    assert [each["checkpoint"]["samples_before"] for each in json.loads(report.read_text())] == [2, 2]
    assert "begun with seed = 0" in error_line(call_script("render.py", *arguments, "--set", "seed=1"))
    assert checkpoints.asked is None


def test_a_command_that_is_stopped_between_frames_reports_those_that_are_done(kept, tmp_path, monkeypatch):
    from rendering.stops import StopRequests

    blend, report = tmp_path / "a.blend", tmp_path / "a.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    done_frames = []
    monkeypatch.setattr(StopRequests, "asked", lambda _: len(done_frames) > 1)
    monkeypatch.setattr(frame, "film_listeners", [lambda *_: done_frames.append(1)])
    out = tmp_path / "pictures" / "p.png"
    done = call_script("render.py", blend, "--frames", "1..4", "-o", out, "--device", "cpu", "--json", report)
    assert done.returncode == 130
    assert sorted(each.name for each in out.parent.iterdir()) == ["p0001.png", "p0002.png"]
    reported = json.loads(report.read_text())
    assert len(reported) == 2 and all(each["complete"] for each in reported)


def test_folders_of_commands_that_were_killed_are_removed(kept, tmp_path):
    blend, out = tmp_path / "a.blend", tmp_path / "pictures"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left, own = out / f".raybatch-{ended.pid}-abc", out / f".raybatch-{os.getpid()}-def"
    for folder in (left, own):
        folder.mkdir(parents=True)
    assert call_script("render.py", blend, "-o", out / "p.png", "--device", "cpu").returncode == 0
    assert not left.exists() and own.exists()
