"""Many random edits in the viewport of a Blender with a window.

    blender --window-geometry 0 0 W H --python scripts/testing/window/soak.py -- REPORT.json [COUNT [SEED]]

COUNT edits (default: 2,000) are drawn with SEED (default: 1): of values, graphs, places, meshes, modifiers, visibility,
views and lamps; objects and materials that come and go, undo and redo, sculpt and edit mode, strokes of a brush,
playback, the render region, another engine for a while, another shading, another file. A third of them do not wait for
a picture. Reported are errors of the viewport and of Python, threads, and the memory of the process after each tenth of
them; Blender prints a traceback or ends where something is worse than that. The exit code is 1 after errors, or where
memory or threads grew by more than a tenth.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import watched

GRIDS, QUADS = 6, 40
WAIT_SECONDS = 0.5  # for a picture at most: none comes of an edit of what is hidden
RECORDS = 10  # of memory
MOST_GROWTH = 1.1  # of memory and threads, from the first third of the records to the last

TBB_CLEAN_ALL_BUFFERS = 0  # of its `scalable_allocation_command`


def memory_bytes() -> int:
    """Resident memory of this process, without what its allocator keeps for later: Blender's Linux builds use TBB's,
    which holds up to a sixth of all memory that way.
    """
    with contextlib.suppress(OSError):  # of another allocator
        ctypes.CDLL("libtbbmalloc.so.2", mode=os.RTLD_NOLOAD).scalable_allocation_command(TBB_CLEAN_ALL_BUFFERS, None)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def grids() -> list[bpy.types.Object]:
    """Objects that edits are made of."""
    return [each for each in bpy.context.scene.objects if each.type == "MESH"]


def leave_modes() -> None:
    """The active object leaves the mode that it is in."""
    active = bpy.context.view_layer.objects.active
    if active is not None and active.mode != "OBJECT":
        with bpy.context.temp_override(**watched.view()):
            bpy.ops.object.mode_set(mode="OBJECT")


class Soak:
    """The edits; each method that begins with `edit_` is one kind."""

    def __init__(self, path: str, count: int, seed: int) -> None:
        self.path, self.count, self.seed, self.random = path, count, seed, random.Random(seed)
        self.kinds: dict[str, Callable[[], None]] = {
            name.removeprefix("edit_"): getattr(self, name) for name in dir(self) if name.startswith("edit_")
        }
        self.watch, self.made, self.watches = watched.Watch(), Counter[str](), False
        self.failed: list[str] = []
        self.records: list[dict[str, int]] = []
        self.number, self.made_at, self.waits, self.begun = 0, 0.0, False, time.perf_counter()
        self.folder = tempfile.TemporaryDirectory()
        self.file = str(Path(self.folder.name) / "soak.blend")
        self.stage = self.prepare

    # --- kinds of edits

    def edit_value(self) -> None:
        nodes = self._nodes()
        nodes["Principled BSDF"].inputs["Roughness"].default_value = self.random.random()

    def edit_graph(self) -> None:
        tree = bpy.data.materials["Noisy"].node_tree
        target = tree.nodes["Principled BSDF"].inputs["Base Color"]
        if target.links:
            tree.links.remove(target.links[0])
        else:
            tree.links.new(tree.nodes["Mix"].outputs["Result"], target)

    def edit_node(self) -> None:
        nodes = self._nodes()
        if "Extra" in nodes:
            nodes.remove(nodes["Extra"])
        else:
            nodes.new("ShaderNodeTexVoronoi").name = "Extra"

    def edit_place(self) -> None:
        self._any().location.z = self.random.uniform(-0.5, 0.5)

    def edit_scale_to_nothing(self) -> None:
        self._any().scale.z = self.random.choice((0.0, 1.0, -1.0))

    def edit_mesh(self) -> None:
        mesh = self._any().data
        corners = [0.0] * (3 * len(mesh.vertices))
        mesh.vertices.foreach_get("co", corners)
        shift = self.random.uniform(-0.01, 0.01)
        mesh.vertices.foreach_set("co", [each + shift for each in corners])
        mesh.update()

    def edit_modifier(self) -> None:
        chosen = self._any()
        if chosen.modifiers:
            chosen.modifiers.clear()
        else:
            chosen.modifiers.new("Bevel", self.random.choice(("SOLIDIFY", "SUBSURF", "DECIMATE")))

    def edit_visibility(self) -> None:
        chosen = self._any()
        chosen.hide_set(not chosen.hide_get())

    def edit_view(self) -> None:
        there = watched.view()["region_data"]
        there.view_distance = self.random.uniform(8.0, 20.0)
        there.view_perspective = self.random.choice(("PERSP", "ORTHO", "CAMERA"))

    def edit_light(self) -> None:
        lamp = bpy.data.objects["Lamp"].data
        lamp.energy = self.random.uniform(0.0, 1000.0)
        lamp.type = self.random.choice(("POINT", "SUN", "SPOT", "AREA"))

    def edit_world(self) -> None:
        background = bpy.context.scene.world.node_tree.nodes["Background"]
        background.inputs["Strength"].default_value = self.random.random()

    def edit_camera(self) -> None:
        scene = bpy.context.scene
        if scene.camera is None:
            scene.camera = next(each for each in scene.objects if each.type == "CAMERA")
        elif self.random.random() < 0.2:
            scene.camera = None
        else:
            scene.camera.data.lens = self.random.uniform(20.0, 80.0)

    def edit_comes(self) -> None:
        mesh = watched.grid_mesh("Grid", self.random.random(), QUADS)
        mesh.materials.append(bpy.data.materials["Noisy"])
        bpy.context.scene.collection.objects.link(bpy.data.objects.new("Grid", mesh))

    def edit_goes(self) -> None:
        if len(grids()) > 2:
            chosen = self._any()
            mesh = chosen.data
            bpy.data.objects.remove(chosen)
            bpy.data.meshes.remove(mesh)

    def edit_undo(self) -> None:
        self._run(bpy.ops.ed.undo_push, message="soak")
        self.edit_value()
        self.edit_place()
        self._run(bpy.ops.ed.undo_push, message="soak")
        self._run(bpy.ops.ed.undo)
        if self.random.random() < 0.5:
            self._run(bpy.ops.ed.redo)

    def edit_mode(self) -> None:
        chosen = self._any()
        chosen.hide_set(False)
        bpy.context.view_layer.objects.active = chosen
        self._run(bpy.ops.object.mode_set, mode=self.random.choice(("SCULPT", "EDIT", "VERTEX_PAINT")))

    def edit_sculpt(self) -> None:
        chosen = self._any()
        chosen.hide_set(False)
        bpy.context.view_layer.objects.active = chosen
        self._run(bpy.ops.object.mode_set, mode="SCULPT")
        region = watched.view()["region"]
        across = self.random.uniform(0.3, 0.7) * region.width
        stroke = [
            {
                "name": "stroke",
                "location": (0.0, 0.0, 0.0),
                "mouse": (across + 10.0 * number, 0.5 * region.height),
                "mouse_event": (across + 10.0 * number, 0.5 * region.height),
                "pressure": 1.0,
                "size": 50.0,
                "x_tilt": 0.0,
                "y_tilt": 0.0,
                "time": 0.05 * number,
                "is_start": number == 0,
            }
            for number in range(4)
        ]
        self._run(bpy.ops.sculpt.brush_stroke, stroke=stroke)

    def edit_playback(self) -> None:
        chosen = self._any()
        if chosen.animation_data is None:
            chosen.keyframe_insert("location", frame=1)
            chosen.location.x += 0.3
            chosen.keyframe_insert("location", frame=20)
        self._run(bpy.ops.screen.animation_play)  # or stops it

    def edit_frame(self) -> None:
        bpy.context.scene.frame_set(self.random.randint(1, 20))

    def edit_region(self) -> None:
        space = watched.view()["space_data"]
        space.use_render_border = not space.use_render_border
        space.render_border_max_x = self.random.uniform(0.5, 1.0)

    def edit_engine(self) -> None:
        scene = bpy.context.scene
        scene.render.engine = "BLENDER_WORKBENCH" if scene.render.engine == "RAYBATCH" else "RAYBATCH"

    def edit_shading(self) -> None:
        shading = watched.view()["space_data"].shading
        shading.type = "SOLID" if shading.type == "RENDERED" else "RENDERED"

    def edit_local_view(self) -> None:
        chosen = self._any()
        chosen.hide_set(False)
        for each in bpy.context.view_layer.objects:
            each.select_set(each is chosen)
        self._run(bpy.ops.view3d.localview)

    def edit_file(self) -> None:
        if self.random.random() < 0.1:
            bpy.ops.wm.save_as_mainfile(filepath=self.file, copy=True, check_existing=False)
            bpy.ops.wm.open_mainfile(filepath=self.file)

    def edit_settings(self) -> None:
        bpy.context.scene.raybatch_viewport.samples = self.random.randint(1, 64)

    # --- how they are made

    def _nodes(self) -> bpy.types.Nodes:
        return bpy.data.materials["Noisy"].node_tree.nodes

    def _any(self) -> bpy.types.Object:
        leave_modes()
        return self.random.choice(grids())

    def _run(self, operator: Any, **options: object) -> None:
        with bpy.context.temp_override(**watched.view()):
            if operator.poll():
                operator(**options)

    def prepare(self) -> bool:
        """Make the scene, and have it shown."""
        watched.make_scene(GRIDS, QUADS)
        watched.show_rendered()
        self.stage = self.begin
        return False

    def begin(self) -> bool:
        """Wait for RayBatch's first picture."""
        if self.watch.viewport is None:
            self.watches = self.watches or self.watch.begin()
            watched.view()["area"].tag_redraw()
        if self.watch.shown:
            self._record()
            self.stage = self.edit
        return False

    def edit(self) -> bool:
        """Make an edit."""
        made = sum(self.made.values())
        if made == self.count:
            self.report()
            return True
        if made and made % max(self.count // RECORDS, 1) == 0 and len(self.records) <= made * RECORDS // self.count:
            self._record()
        kind = self.random.choice(list(self.kinds))
        if made % 10 == 9:  # from time to time the view is what is tried again
            bpy.context.scene.render.engine = "RAYBATCH"
            watched.view()["space_data"].shading.type = "RENDERED"
        self.number, self.made_at = self.watch.asked, time.perf_counter()
        self.made[kind] += 1
        try:
            if kind not in ("mode", "sculpt"):
                leave_modes()
            self.kinds[kind]()
        except Exception:
            self.failed.append(f"{kind}: {traceback.format_exc(limit=-2)}")
        watched.view()["area"].tag_redraw()
        self.waits = self.random.random() < 0.66
        self.stage = self.wait
        return False

    def wait(self) -> bool:
        """Wait for a picture, if one is waited for and comes."""
        waited = time.perf_counter() - self.made_at
        if not self.waits or self.watch.shown > self.number or waited > WAIT_SECONDS:
            self.stage = self.edit
        return False

    def _record(self) -> None:
        self.records.append(
            {
                "edits": sum(self.made.values()),
                "memory_bytes": memory_bytes(),
                "threads": threading.active_count(),
                "objects": len(bpy.data.objects),
                "pictures": self.watch.pictures,
            }
        )
        print(self.records[-1], flush=True)

    def report(self) -> None:
        """Write what was found."""
        self._record()
        self.folder.cleanup()
        watched.write(
            self.path,
            {
                "blender": bpy.app.version_string,
                "seed": self.seed,
                "edits": dict(sorted(self.made.items())),
                "seconds": round(time.perf_counter() - self.begun),
                "callbacks": len(self.watch.callbacks),
                "records": self.records,
                "grew": self.grew,
                "failed": self.failed,
                "errors": sorted(set(self.watch.errors)),
            },
        )

    @property
    def grew(self) -> dict[str, float]:
        """Memory and threads at the end over those after the first edits, each the most of a third of the records: at
        times nothing is rendered, and a leak raises the most too.
        """
        third = max(len(self.records) // 3, 1)
        first, last = self.records[1 : 1 + third], self.records[-third:]
        return {
            name: round(max(each[name] for each in last) / max(each[name] for each in first), 3)
            for name in ("memory_bytes", "threads")
        }

    @property
    def is_good(self) -> bool:
        """Whether nothing failed or grew."""
        return not self.failed and not self.watch.errors and max(self.grew.values()) <= MOST_GROWTH

    def step(self) -> bool:
        """What comes next; True at the end."""
        return self.stage()


if __name__ == "__main__":
    given = [*watched.arguments(), "", ""]
    if not given[0]:
        raise SystemExit(f"soak.py: give a file for the report behind --\n{__doc__}")
    soak = Soak(given[0], int(given[1] or 2000), int(given[2] or 1))
    watched.every(0.01, soak.step, lambda: soak.is_good)
