"""Exit codes of a Blender without a window whose renders end without a picture, of which engines hear nothing."""

import subprocess
import sys

import pytest

pytest.importorskip("bpy")

from raybatch_addon.blender import exit_code

# As in Blender's program, not its module: arguments: a folder, and what is tried
PROCESS = """
import sys
from types import SimpleNamespace
import bpy
import raybatch_addon
from raybatch_addon.blender.status import ends, terminal
from tests.blender.features.compare import empty_scene

ends.bpy = SimpleNamespace(app=SimpleNamespace(background=True, module=False, handlers=bpy.app.handlers))
terminal.WAITS = True
raybatch_addon.register()
folder, what = sys.argv[1:]
scene = empty_scene()
scene.render.resolution_x = scene.render.resolution_y = 8
scene.frame_start, scene.frame_end = 1, 2
scene.render.image_settings.file_format = "PNG"
if what != "other engine":
    scene.raybatch.sample_count = 1
else:
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
open(folder + "/file", "w").close()

def render(name):
    scene.render.filepath = f"{folder}/{name}_"
    try:
        bpy.ops.render.render(animation=True)
    except RuntimeError as error:
        print(error)

begun = []
bpy.app.handlers.render_init.append(lambda *_: begun.append(1))
if what == "not begun":
    for handler in bpy.app.handlers.render_init:
        handler(scene, None)
else:
    render("there" if what == "written" else "file/there")
if what == "then written":
    render("there")
print("begun", len(begun))
"""


@pytest.mark.parametrize(
    "what, code, begun",
    [
        ("written", 0, 1),
        ("not written", exit_code.RENDER_FAILED, 1),
        ("then written", exit_code.RENDER_FAILED, 2),
        ("not begun", exit_code.RENDER_FAILED, 1),
        ("other engine", 0, 1),
    ],
)
def test_a_render_without_its_picture_has_an_exit_code(what, code, begun, tmp_path):
    command = [sys.executable, "-c", PROCESS, str(tmp_path), what]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert f"begun {begun}" in done.stdout, done.stdout + done.stderr
    assert done.returncode == code, done.stdout + done.stderr
    names = sorted(path.name for path in tmp_path.glob("*.png"))
    assert names == (["there_0001.png", "there_0002.png"] if "written" in what and what != "not written" else [])
    assert ("Finished" in done.stdout) == bool(names), "behind an error no end is said"
