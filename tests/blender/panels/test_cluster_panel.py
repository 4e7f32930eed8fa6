"""Render on Cluster: a command line is begun, followed and stopped, its picture is shown, and its errors are said."""

import sys
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.ui import preferences
from raybatch_addon.ui.cluster import operators, running
from raybatch_addon.ui.cluster.panel import RAYBATCH_RENDER_PT_cluster
from tests.support.blender_builders import add_grid
from tests.support.panel_layout import context_of, drawn

ROOT = Path(__file__).resolve().parents[3]

# Stands in for render.py: notes its arguments, and does what the test says
FAKE = """
import os, shutil, sys, time
from pathlib import Path

here = Path(__file__).parent
(here / "arguments").write_text("\\n".join(sys.argv[1:]))
(here / "variables").write_text("\\n".join(os.environ))

def say(text):
    print(text, file=sys.stderr, flush=True)

def wait(name):
    while not (here / name).exists():
        time.sleep(0.02)
"""


@pytest.fixture
def own(scene):
    """The add-on's preferences, as those of an add-on that is enabled."""
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.PACKAGE
    own = addon.preferences
    own.cluster_address, own.cluster_python = "local:1", sys.executable
    yield own
    running.forget()
    if bpy.app.timers.is_registered(running.look_at_job):
        bpy.app.timers.unregister(running.look_at_job)
    bpy.context.preferences.addons.remove(addon)


@pytest.fixture
def saved(scene, tmp_path):
    """The scene's file."""
    path = tmp_path / "a.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def command(own, tmp_path):
    """Make a command line that does what `code` says; its folder."""
    folder = tmp_path / "scripts"
    folder.mkdir()

    def make(code):
        (folder / "render.py").write_text(FAKE + code)
        own.cluster_script = str(folder / "render.py")
        return folder

    return make


def follow(until=lambda: False, seconds=60.0):
    """What Blender's timer does, until it ends; what the panel showed meanwhile."""
    shown, end = [], time.monotonic() + seconds
    while running.look_at_job() is not None and not until():
        shown += panel()
        assert time.monotonic() < end, "it does not end"
        time.sleep(0.05)
    return shown


def notes():
    """What the panel shows, a line each."""
    return drawn(RAYBATCH_RENDER_PT_cluster, context_of(bpy.context.scene))


def panel():
    return [note[1] for note in notes()]


def error_of(**options):
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.raybatch.render_on_cluster(**options)
    return str(caught.value)


def test_the_picture_comes_as_an_image(own, command, saved, tmp_path):
    picture = tmp_path / "made.exr"
    image = bpy.data.images.new("made", 4, 3, float_buffer=True)
    image.pixels.foreach_set([0.25] * 48)
    image.file_format, image.filepath_raw = "OPEN_EXR", str(picture)
    image.save()
    saved_value = bpy.data.images.load(str(picture)).pixels[0]  # Blender 4.5 writes another than it holds
    folder = command(f"""
say("render.py: warning: a material is missing")
say("Waiting for workers of the cluster")
say("3.0/4 samples, 1.20 Mrays/s, 0:12 left")
wait("go")
out = sys.argv[sys.argv.index("-o") + 1]
shutil.copy({str(picture)!r}, out)
say(f"render.py: saved {{out}}")
""")
    bpy.ops.wm.save_mainfile()
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    assert not bpy.ops.raybatch.render_on_cluster.poll(), "one at a time"
    follow(lambda: "3.0 of 4 samples" in running.current.process.message)
    assert "75 %" in panel() and any("1.20 Mrays/s" in each for each in panel())
    (folder / "go").touch()
    follow()
    assert running.current.error == ""
    shown = bpy.data.images[running.IMAGE]
    assert tuple(shown.size) == (4, 3) and shown.is_float and shown.use_view_as_render
    assert abs(shown.pixels[0] - saved_value) < 1e-3
    assert any("a material is missing" in each for each in panel())
    arguments = (folder / "arguments").read_text().split("\n")
    assert arguments[:2] == [str(saved), "--frame=1"] and arguments[-2:] == ["--cluster", "local:1"]
    assert not {"PYTHONPATH", "PYTHONHOME"} & {*(folder / "variables").read_text().split("\n")}
    # a second one takes its place
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    follow()
    assert [each.name for each in bpy.data.images if running.IMAGE in each.name] == [running.IMAGE]


def test_what_is_not_saved_goes_as_a_copy(own, command, saved, monkeypatch):
    folder = command("")
    monkeypatch.setattr(operators, "_is_changed", lambda: True)
    add_grid("Later", 1)
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    follow()
    copy = Path((folder / "arguments").read_text().split("\n")[0])
    assert copy != saved and bpy.data.filepath == str(saved)
    with bpy.data.libraries.load(str(copy)) as (there, _):
        assert "Later" in there.objects
    running.forget()
    assert not copy.exists()


def test_frames_are_counted_and_a_stop_keeps_those_that_are_there(own, command, saved, tmp_path):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 3, 6
    scene.render.filepath = str(tmp_path / "out" / "f")
    bpy.ops.wm.save_mainfile()
    folder = command("""
import signal
signal.signal(signal.SIGTERM, lambda *_: (say("render.py: stopped"), os._exit(130)))
say("render.py: saved /nowhere/f0003.png")
say("frame 4: 1.0/2 samples, 1.00 Mrays/s")
wait("never")
""")
    assert bpy.ops.raybatch.render_on_cluster(animation=True) == {"FINISHED"}
    follow(lambda: "samples" in running.current.process.message)
    assert running.current.process.message.startswith("Frame 4, 2 of 4: 1.0 of 2 samples")
    assert running.current.process.fraction == 0.375
    assert bpy.ops.raybatch.stop_on_cluster() == {"FINISHED"}
    follow()
    assert running.current.error == "" and "It was stopped" in panel()
    arguments = (folder / "arguments").read_text().split("\n")
    assert arguments[1:4] == ["--frames=3..6", "-o", str(tmp_path / "out" / "f")]


def test_the_end_of_the_add_on_ends_it(own, command, saved):
    command('wait("never")')
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    job = running.current
    running.forget()
    assert not job.process.is_running or job.process._process.poll() is not None
    assert not job.folder.exists()


@pytest.mark.parametrize(
    "code, expected",
    [
        ('say("render.py: error: Dask is not installed: pip install it"); sys.exit(1)', "Dask is not installed"),
        (
            'say("render.py: error: there is no scheduler at tcp://a:1"); sys.exit(1)',
            "there is no scheduler at tcp://a:1",
        ),
        ('raise ImportError("no module named warp")', "ended with code 1: ImportError: no module named warp"),
    ],
)
def test_errors_of_the_command_line_are_shown(own, command, saved, code, expected):
    command(code)
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    follow()
    assert expected in running.current.error
    assert any(note[2] == "ERROR" for note in notes() if note[0] == "label")


def test_what_lacks_is_named_with_its_remedy(own, saved, tmp_path):
    assert "choose scripts/render.py of RayBatch's folder in Preferences" in error_of()
    assert "hoose scripts/render.py" in " ".join(panel())
    own.cluster_script = str(tmp_path / "a.blend")
    assert "is no render.py" in error_of()
    own.cluster_script = str(ROOT)  # the folder will do
    own.cluster_python = str(tmp_path / "python")
    assert "there is no Python" in error_of()
    own.cluster_python = str(saved)
    assert "cannot be run (Permission denied): choose another Python" in error_of()
    own.cluster_python = sys.executable
    for address, expected in (
        ("", "no cluster is named"),
        ("local:0", "names no cluster"),
        ("here", "names no cluster"),
    ):
        own.cluster_address = address
        assert expected in error_of() and "as tcp://host:8786, or local:2" in error_of()
    own.cluster_address = "local:1"
    bpy.context.scene.frame_step = 2
    assert "set the step of the frame range to 1" in error_of(animation=True)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    bpy.context.scene.render.engine = "RAYBATCH"
    assert "was never saved: save it" in error_of()


def test_a_checkout_without_an_environment_is_named(own, command, saved):
    command("")
    own.cluster_python = ""
    assert "has no environment .venv: make it with `make environment`, or choose a Python" in error_of()


def test_an_add_on_that_is_not_enabled(scene, saved):
    assert "not enabled in Preferences > Add-ons" in error_of()


def test_a_true_render(own, saved):
    pytest.importorskip("distributed")
    add_grid("Grid", 2)
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 16, 12
    bpy.ops.wm.save_mainfile()
    own.cluster_script = str(ROOT / "scripts/render.py")
    assert bpy.ops.raybatch.render_on_cluster() == {"FINISHED"}
    follow(seconds=240.0)
    assert running.current.error == ""
    assert tuple(bpy.data.images[running.IMAGE].size) == (16, 12)
