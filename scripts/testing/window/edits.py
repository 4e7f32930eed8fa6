"""How soon the viewport of a Blender with a window shows an edit.

    blender --window-geometry 0 0 W H --python scripts/testing/window/edits.py -- REPORT.json [COUNT [KIND ...]]

A scene of 493,000 triangles is looked at in the largest 3D view, with RayBatch as its engine. COUNT edits of each KIND
(default: 50 of all) are made from Blender's main loop, each half a second after the picture of the one before was
drawn, while that is refined. Reported are the seconds from the edit to the end of the first `view_draw` with a picture
of it, and those of all callbacks. The first edits wait for what has to be compiled, if anything has.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import watched

PAUSE_SECONDS = 0.5  # between a picture and the next edit
WAIT_SECONDS = 120.0  # for a picture at most


def _orbit(step: int) -> None:
    there = watched.view()["region_data"]
    there.view_perspective, there.view_distance = "PERSP", 14.0 + 0.05 * (step % 20 + 1)


def _camera(step: int) -> None:
    watched.view()["region_data"].view_perspective = "CAMERA"
    bpy.context.scene.camera.location.x = 4.5 + 0.02 * (step + 1)


def _world(step: int) -> None:
    background = bpy.context.scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.2, 0.3, 0.3 + 0.01 * (step % 30 + 1), 1.0)


def _light(step: int) -> None:
    bpy.data.lights["Lamp"].energy = 700.0 + 10.0 * step


def _value(step: int) -> None:
    nodes = bpy.data.materials["Noisy"].node_tree.nodes
    nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.1 + 0.01 * step


def _graph(step: int) -> None:
    tree = bpy.data.materials["Noisy"].node_tree
    target = tree.nodes["Principled BSDF"].inputs["Base Color"]
    if step % 2:
        tree.links.new(tree.nodes["Mix"].outputs["Result"], target)
    else:
        tree.links.remove(target.links[0])


def _place(step: int) -> None:
    bpy.data.objects["Grid 5"].location.z = 0.02 * (step + 1)


def _mesh(step: int) -> None:
    mesh = bpy.data.objects["Grid 2"].data
    mesh.vertices.foreach_set("co", watched.grid_corners(0.1 * (step + 1)))
    mesh.update()


def _modifier(step: int) -> None:
    chosen = bpy.data.objects["Grid 3"]
    bend = chosen.modifiers.get("Bend") or chosen.modifiers.new("Bend", "SIMPLE_DEFORM")
    bend.deform_method, bend.angle = "BEND", 0.01 * (step + 1)


def _visibility(step: int) -> None:
    bpy.data.objects["Grid 7"].hide_set(step % 2 == 0)


EDITS: dict[str, Callable[[int], None]] = {
    "view": _orbit,
    "camera": _camera,
    "world": _world,
    "light": _light,
    "value": _value,
    "graph": _graph,
    "transform": _place,
    "mesh": _mesh,
    "modifier": _modifier,
    "visibility": _visibility,
}


class Edits:
    """The edits one after the other, as Blender's timers call for them."""

    def __init__(self, path: str, count: int, kinds: list[str]) -> None:
        self.path, self.watch = path, watched.Watch()
        self.queue = [(kind, step) for kind in kinds for step in range(count)]
        self.seconds: dict[str, list[float]] = {kind: [] for kind in kinds}
        self.first = 0.0  # seconds until the first picture
        self.made_at, self.number, self.kind, self.watches = 0.0, 0, "", False
        self.stage = self.prepare

    def prepare(self) -> bool:
        """Make the scene, and have it shown."""
        watched.make_scene()
        watched.show_rendered()
        self.made_at = time.perf_counter()
        self.stage = self.begin
        return False

    def begin(self) -> bool:
        """Wait for RayBatch's first picture."""
        if self.watch.viewport is None and not self.watches:
            self.watches = self.watch.begin()
            watched.view()["area"].tag_redraw()
        if self.watch.shown:
            self.first = self.watch.when_shown - self.made_at
            self.stage = self.edit
        return False

    def edit(self) -> bool:
        """Make the next edit, once the picture before has been there for a while."""
        if time.perf_counter() - self.watch.when_shown < PAUSE_SECONDS:
            return False
        if not self.queue:
            self.report()
            return True
        self.kind, step = self.queue.pop(0)
        self.number = self.watch.asked
        self.made_at = time.perf_counter()
        EDITS[self.kind](step)
        watched.view()["area"].tag_redraw()
        self.stage = self.wait
        return False

    def wait(self) -> bool:
        """Wait for its picture."""
        if self.watch.shown > self.number:
            self.seconds[self.kind].append(self.watch.when_shown - self.made_at)
            self.stage = self.edit
        elif time.perf_counter() - self.made_at > WAIT_SECONDS:
            raise TimeoutError(f"no picture after {WAIT_SECONDS:.0f} s of the edit {self.kind}")
        return False

    def report(self) -> None:
        """Write what was measured."""
        region, callbacks = watched.view()["region"], sorted(self.watch.callbacks)
        watched.write(
            self.path,
            {
                "blender": bpy.app.version_string,
                "region": [region.width, region.height],
                "triangles": sum(len(mesh.polygons) * 2 for mesh in bpy.data.meshes),
                "first_seconds": round(self.first, 3),
                "edits": {
                    kind: {
                        "count": len(each),
                        "median": round(statistics.median(each), 3),
                        "share_95": round(sorted(each)[int(0.95 * (len(each) - 1))], 3),
                        "worst": round(max(each), 3),
                    }
                    for kind, each in self.seconds.items()
                    if each
                },
                "callbacks": {
                    "count": len(callbacks),
                    "share_99": round(callbacks[int(0.99 * (len(callbacks) - 1))], 4),
                    "worst": round(callbacks[-1], 4),
                },
                "errors": sorted(set(self.watch.errors)),
            },
        )

    def step(self) -> bool:
        """What comes next; True at the end."""
        return self.stage()


if __name__ == "__main__":
    given = watched.arguments()
    if not given:
        raise SystemExit(f"edits.py: give a file for the report behind --\n{__doc__}")
    count = int(given[1]) if len(given) > 1 else 50
    watched.every(0.01, Edits(given[0], count, given[2:] or list(EDITS)).step)
