"""What a first render needs is made beforehand, once."""

import subprocess
import sys
from pathlib import Path

WARMED_UP = """
import sys
import bpy
sys.path.insert(0, sys.argv[1])
import raybatch_addon
raybatch_addon.register()
from raybatch_addon.blender import warm_up
from raybatch_addon.ui import preferences
scene = bpy.context.scene
assert preferences._warm_up() == 1.0 and "warp" not in sys.modules, "the scene is another engine's"
scene.render.engine = "RAYBATCH"
assert preferences._warm_up() is None
scene.render.resolution_x, scene.render.resolution_y, scene.raybatch.sample_count = 8, 8, 1
bpy.ops.render.render()  # while that is under way
from raybatch_addon.core.wavefront.stages.stage import all_stages_kernel
assert all_stages_kernel.cache_info().misses == 1, "made once"
from raybatch_addon.blender import reports
assert not reports.last().warnings and not reports.last().errors
"""


def test_a_render_finds_what_was_made_before_it():
    done = subprocess.run([sys.executable, "-c", WARMED_UP, str(Path.cwd())], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


AS_RENDERS_BEGIN = """
import sys
import bpy
sys.path.insert(0, sys.argv[1])
import raybatch_addon
raybatch_addon.register()
from raybatch_addon.blender import warm_up
from raybatch_addon.ui import preferences
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y, scene.raybatch.sample_count = 8, 8, 1
scene.render.engine = "BLENDER_WORKBENCH"
preferences._before_render(scene)
assert warm_up._thread is None and "warp" not in sys.modules, "the scene is another engine's"
scene.render.engine = "RAYBATCH"
bpy.ops.render.render()
assert warm_up._thread is not None and not warm_up._thread.is_alive()
from raybatch_addon.blender import reports
assert not reports.last().warnings and not reports.last().errors
raybatch_addon.unregister()
assert preferences._before_render not in bpy.app.handlers.render_init
"""


def test_without_a_window_it_is_made_as_a_render_begins():
    done = subprocess.run([sys.executable, "-c", AS_RENDERS_BEGIN, str(Path.cwd())], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
