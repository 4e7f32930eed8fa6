"""The add-on is disabled, and enabled again, while it renders."""

import json

import pytest

pytest.importorskip("bpy")

from tests.support.command_line import run_python
from tests.support.running.shares import thorough_but

BEGINNING = """
import faulthandler, gc, sys, threading
faulthandler.dump_traceback_later(200, exit=True)
import bpy
import raybatch_addon as addon
from raybatch_addon.blender import finals, frame, reports, sessions
from tests.blender.features.compare import empty_scene
from tests.blender.viewport.regions import region_context, wait_for

addon._END_SECONDS = 1e9  # who waits for a render that was not asked to end waits too long
addon.register()
ENDLESS = 10**6

def made(samples):
    scene = empty_scene()
    bpy.ops.mesh.primitive_cube_add(size=2)
    scene.world = bpy.data.worlds.new("World")
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    scene.raybatch.sample_count = samples
    scene.render.filepath = sys.argv[1] + "/out"
    return scene

def rendered(**options):
    \"\"\"What Blender says of a render: nothing where it succeeds.\"\"\"
    try:
        bpy.ops.render.render(**options)
    except RuntimeError as error:
        return str(error)
    return ""

def shown():
    \"\"\"A viewport that renders.\"\"\"
    from raybatch_addon.blender.viewport.viewport import Viewport
    from raybatch_addon.blender.viewport.draw import PictureTexture
    PictureTexture.draw = lambda *_: None
    bpy.context.scene.raybatch_viewport.samples = ENDLESS
    viewport, context = Viewport(lambda: None), region_context()
    def is_shown():
        viewport.draw(None, context, bpy.context.evaluated_depsgraph_get())
        return viewport.render.picture is not None
    wait_for(is_shown)
    return viewport

def assert_gone():
    assert not hasattr(bpy.types.Scene, "raybatch") and not finals.are_under_way()
    assert not sessions._sessions and not sessions._is_lent
    gc.collect()
    wait_for(lambda: threading.enumerate() == [threading.main_thread()])  # pools end when they are looked at
    for handlers in (bpy.app.handlers.render_init, bpy.app.handlers.render_cancel):
        assert not [each for each in handlers if each.__module__.startswith("raybatch")]

def assert_renders():
    \"\"\"Enabled again it renders, and shows viewports.\"\"\"
    addon.register()
    films = []
    frame.film_listeners[:] = [lambda *found: films.append(found[-1])]
    made(2)
    assert rendered() == "" and films[0].complete and films[0].passes["Combined"].any()
    viewport = shown()
    addon.unregister()
    assert not viewport.render._thread.is_alive()
    assert_gone()
    print("well")
"""

FROM_ANOTHER_THREAD = """
scene = made(ENDLESS)
viewport = shown()
begun, said = threading.Event(), []
def look(progress):
    if progress.stage == sys.argv[2]:
        begun.set()
frame.progress_listeners.append(look)
if sys.argv[2] == "build":  # which a fast machine reports nothing of
    import time
    from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
    build = DeviceScene.build
    def slow_build(*arguments, **options):
        if finals.are_under_way():  # the viewport builds too
            begun.set()
            time.sleep(1.0)
        return build(*arguments, **options)
    DeviceScene.build = slow_build
thread = threading.Thread(target=lambda: said.append(rendered()))
thread.start()
assert begun.wait(120)
addon.unregister()
thread.join()
frame.progress_listeners.clear()
assert "RayBatch was disabled" in said[0], said
assert_gone()
assert_renders()
"""

FROM_THE_RENDER = """
made(ENDLESS)
viewport = shown()
asked = []
def disable(*_):
    if not asked:
        asked.append(1)
        addon.unregister()
listeners = {"scene": frame.scene_listeners, "progress": frame.progress_listeners,
    "render_init": bpy.app.handlers.render_init, "render_pre": bpy.app.handlers.render_pre}[sys.argv[2]]
listeners.append(disable)
ends = []
for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
    handlers.append(lambda *_: ends.append(1))
said = rendered()
listeners.remove(disable)
assert asked and "RayBatch was disabled" in said, said
assert ends  # who comes behind RayBatch's handlers is called although these go
assert_gone()
assert_renders()
"""

BETWEEN_FRAMES = """
scene = made(2)
scene.frame_start, scene.frame_end = 1, 5
def disable(*_):
    if bpy.context.scene.frame_current == 2:
        addon.unregister()
bpy.app.handlers.render_write.append(disable)
said = rendered(animation=True)
bpy.app.handlers.render_write.remove(disable)
import os
assert "RayBatch was disabled" in said and sorted(os.listdir(sys.argv[1])) == ["out0001.png", "out0002.png"]
assert_gone()
assert_renders()
"""

RELOADED_IN_THE_RENDER = """
from raybatch_addon.blender.viewport import callbacks
scene = made(64)
viewport = shown()
class Engine:
    tag_redraw = update_stats = lambda *_: None
engine = Engine()
engine.viewport = viewport
films, asked = [], []
def reload(*_):
    if not asked:
        asked.append(1)
        addon.unregister()
        addon.register()
frame.progress_listeners.append(reload)
frame.film_listeners.append(lambda *found: films.append(found[-1]))
assert rendered() == "" and films[0].complete
frame.progress_listeners.clear()
viewport.render.join()
before, context = viewport.render.picture, region_context()
def is_shown_again():
    callbacks.view_draw(engine, context, bpy.context.evaluated_depsgraph_get())
    return engine.viewport.render.picture not in (None, before)
wait_for(is_shown_again)
addon.unregister()
assert_gone()
assert_renders()
"""

UPDATED_IN_THE_RENDER = """
made(ENDLESS)
viewport = shown()
begun, said = threading.Event(), []
frame.progress_listeners.append(lambda progress: progress.stage == "render" and begun.set())
thread = threading.Thread(target=lambda: said.append(rendered()))
thread.start()
assert begun.wait(120)
addon.unregister()
thread.join()
assert "RayBatch was disabled" in said[0], said
assert_gone()
for name in [*sys.modules]:
    if name.startswith("raybatch_addon"):
        del sys.modules[name]
import raybatch_addon as addon
from raybatch_addon.blender import finals, frame, reports, sessions
assert_renders()
"""

UPDATED_BY_THE_RENDER = """
made(ENDLESS)
begun = []
def update(progress):
    if progress.stage == "render" and not begun:
        begun.append(1)
        addon.unregister()
        for name in [*sys.modules]:
            if name.startswith("raybatch_addon"):
                del sys.modules[name]
frame.progress_listeners.append(update)
assert "RayBatch was disabled" in rendered()
assert_gone()
import raybatch_addon as addon
from raybatch_addon.blender import finals, frame, reports, sessions
assert_renders()
"""

NOT_BEGUN = """
import atexit
from pathlib import Path
scene = made(2)
viewport = shown()
Path(sys.argv[1], "file").touch()
scene.render.filepath = sys.argv[1] + "/file/movie"
if hasattr(scene.render.image_settings, "media_type"):  # Blender 5
    scene.render.image_settings.media_type = "VIDEO"
scene.render.image_settings.file_format = "FFMPEG"
rendered(animation=True)
assert finals.are_under_way()  # Blender told of a beginning alone
addon.unregister()
assert finals.are_under_way() and hasattr(bpy.types.Scene, "raybatch")
atexit._run_exitfuncs()
assert_gone()
print("well")
"""

KEPT = """
scene = made(ENDLESS)
scene.raybatch_checkpoint.use = True
left = [20]
def disable(progress):
    left[0] -= progress.stage == "render"
    if not left[0]:
        addon.unregister()
frame.progress_listeners.append(disable)
assert "RayBatch was disabled" in rendered()
frame.progress_listeners.clear()
assert_gone()
from pathlib import Path
from raybatch_addon.core.checkpoint.file import load_kept
path, = Path(sys.argv[1]).glob("*.checkpoint")
assert load_kept(path).film().sample_total > 0
assert_renders()
"""


def assert_well(code, *arguments):
    done = run_python(BEGINNING + code, *arguments)
    assert done.returncode == 0 and done.stdout.splitlines()[-1:] == ["well"], done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    return done


# Each leaves RayBatch disabled and nothing of it behind, so that they follow each other in one process
PLACES = ("render_init", "render_pre", "scene", "progress")
SCENARIOS = {
    **{f"from another thread, {stage}": (FROM_ANOTHER_THREAD, stage) for stage in ("render", "build")},
    **{f"from the render, {place}": (FROM_THE_RENDER, place) for place in PLACES},
    "between frames": (BETWEEN_FRAMES, ""),
    "reloaded in the render": (RELOADED_IN_THE_RENDER, ""),
    "kept": (KEPT, ""),
}
ONE_BY_ONE = """
import json
for name, (code, argument, folder) in json.loads(sys.argv[1]).items():
    faulthandler.dump_traceback_later(60, exit=True)
    sys.argv[1:] = [folder, argument]
    addon.register()
    exec(code)
    print("done:", name, flush=True)
"""


@pytest.fixture(scope="module")
def disabled(tmp_path_factory, pytestconfig):
    """The names of the scenarios that went well, and what was said of the first that did not."""
    left_out = () if pytestconfig.option.thorough else ("from the render, render_pre",)
    chosen = {
        name: (code, argument, str(tmp_path_factory.mktemp("disabled")))
        for name, (code, argument) in SCENARIOS.items()
        if name not in left_out
    }
    done = run_python(BEGINNING.replace("addon.register()\n", "", 1) + ONE_BY_ONE, json.dumps(chosen))
    well = [line.removeprefix("done: ") for line in done.stdout.splitlines() if line.startswith("done: ")]
    return well, "" if done.returncode == 0 and "Traceback" not in done.stderr else done.stdout + done.stderr


def assert_went_well(disabled, name):
    well, said = disabled
    assert name in well and not said, said or f"only these went well: {well}"


@pytest.mark.parametrize("stage", ["render", "build"])
def test_disabled_from_another_thread_ends_the_render_and_the_viewport(stage, disabled):
    """As in Blender's window: the render has a thread, and the preferences are on the main one."""
    assert_went_well(disabled, f"from another thread, {stage}")


@pytest.mark.parametrize("place", thorough_but(["render_init", "scene", "progress"], PLACES))
def test_disabled_by_the_render_itself_goes_when_that_has_ended(place, disabled):
    assert_went_well(disabled, f"from the render, {place}")


def test_disabled_between_frames_ends_the_animation(disabled):
    assert_went_well(disabled, "between frames")


def test_disabled_and_enabled_by_the_render_goes_on(disabled):
    assert_went_well(disabled, "reloaded in the render")


def test_a_render_that_was_ended_leaves_its_checkpoint(disabled):
    assert_went_well(disabled, "kept")


def test_updated_during_a_render_renders_by_its_new_modules(tmp_path):
    """As Blender updates extensions: what was imported is forgotten."""
    assert_well(UPDATED_IN_THE_RENDER, tmp_path)


def test_updated_by_the_render_itself_goes_by_its_old_modules(tmp_path):
    assert_well(UPDATED_BY_THE_RENDER, tmp_path)


def test_a_movie_that_cannot_be_written_keeps_nothing_at_exit(tmp_path):
    """Blender tells of the end of no such render: who disables RayBatch is told that it stays, and it goes at exit."""
    done = assert_well(NOT_BEGUN, tmp_path)
    assert done.stderr.count("RayBatch is disabled once it has ended") == 1
