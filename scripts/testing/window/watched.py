"""What the scripts in this folder share: the scene, the 3D view, and what RayBatch's viewport does there."""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

VIEWPORT = "blender.viewport.viewport"  # the end of the name of RayBatch's module, however it was installed
GRID = 157  # quads along an edge of a grid: ten of them are 492,980 triangles


class Watch:
    """Callbacks of RayBatch's viewport: what each took, and when a picture of a new request was drawn."""

    def __init__(self) -> None:
        self.callbacks: list[float] = []  # [s]
        self.errors: list[str] = []
        self.viewport: Any = None  # that was drawn last
        self.shown = 0  # the number of the request whose picture was drawn last
        self.when_shown = 0.0  # of the first draw of that request [s]
        self.pictures = 0  # of requests, drawn so far

    def begin(self) -> bool:
        """Look at callbacks from now on, if the module is there yet."""
        module = next((each for name, each in sys.modules.items() if name.endswith(VIEWPORT)), None)
        kind, watch = getattr(module, "Viewport", None), self
        if kind is None:  # it is still being imported
            return False
        draw, update = kind.draw, kind.update

        def watched_draw(viewport: Any, *arguments: Any) -> None:
            start = time.perf_counter()
            draw(viewport, *arguments)
            watch.note(viewport, start)

        def watched_update(viewport: Any, *arguments: Any) -> None:
            start = time.perf_counter()
            update(viewport, *arguments)
            watch.callbacks.append(time.perf_counter() - start)

        kind.draw, kind.update = watched_draw, watched_update
        return True

    def note(self, viewport: Any, start: float) -> None:
        """`viewport` was drawn, which began at `start`."""
        now = time.perf_counter()
        self.callbacks.append(now - start)
        picture = viewport.render.picture
        if viewport is not self.viewport:
            self.viewport, self.shown = viewport, 0
        if picture is not None and picture.request.number > self.shown:
            self.shown, self.when_shown = picture.request.number, now
            self.pictures += 1
        if viewport.status()[1] and (viewport._error or viewport.render.state.error):
            self.errors.append(viewport.status()[1])

    @property
    def asked(self) -> int:
        """The number of the newest request."""
        return self.viewport._number if self.viewport is not None else 0


def arguments() -> list[str]:
    """Of the command line, behind `--`."""
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def make_scene(count: int = 10, quads: int = GRID) -> None:
    """Waving grids, `count` of `quads` by `quads`, with nodes, a lamp, a world and a camera, and nothing else."""
    for each in list(bpy.data.objects):
        bpy.data.objects.remove(each)
    scene = bpy.context.scene
    scene.render.engine = "RAYBATCH"
    material = bpy.data.materials.new("Noisy")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    noise = nodes.new("ShaderNodeTexNoise")
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    mix.name = "Mix"
    links.new(noise.outputs["Fac"], mix.inputs["Factor"])
    links.new(mix.outputs["Result"], nodes["Principled BSDF"].inputs["Base Color"])
    for number in range(count):
        mesh = grid_mesh(f"Grid {number}", number, quads)
        mesh.materials.append(material)
        grid = bpy.data.objects.new(mesh.name, mesh)
        grid.location = (3.0 * (number % 4), 3.0 * (number // 4), 0.0)
        scene.collection.objects.link(grid)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.location, lamp.data.energy, lamp.data.size = (4.0, 3.0, 6.0), 800.0, 3.0
    scene.collection.objects.link(lamp)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (4.5, -8.0, 8.0), (0.9, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True


def grid_corners(phase: float, quads: int = GRID) -> np.ndarray:
    """Positions of the vertices of a grid of `quads` by `quads` in waves, float32, flat."""
    axis = np.linspace(-1.3, 1.3, quads + 1, dtype=np.float32)
    x, y = np.meshgrid(axis, axis)
    return np.stack([x, y, 0.2 * np.sin(5 * x + np.float32(phase)) * np.cos(4 * y)], axis=-1).ravel()


def grid_mesh(name: str, phase: float, quads: int = GRID) -> bpy.types.Mesh:
    """A grid of `quads` by `quads` in waves."""
    mesh = bpy.data.meshes.new(name)
    corners = grid_corners(phase, quads)
    first = (np.arange(quads)[:, None] * (quads + 1) + np.arange(quads)).reshape(-1, 1)
    faces = first + np.array([0, 1, quads + 2, quads + 1])
    mesh.vertices.add(len(corners) // 3)
    mesh.vertices.foreach_set("co", corners)
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel().astype(np.int32))
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def view() -> dict[str, Any]:
    """Window, area, region and space of the largest 3D view, as `temp_override` takes them."""
    found = [
        (area.width * area.height, window, area)
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D"
    ]
    if not found:
        raise SystemExit("there is no 3D view")
    _, window, area = max(found, key=lambda each: each[0])
    region = next(each for each in area.regions if each.type == "WINDOW")
    return {
        "window": window,
        "screen": window.screen,
        "area": area,
        "region": region,
        "space_data": area.spaces.active,
        "region_data": area.spaces.active.region_3d,
    }


def show_rendered() -> None:
    """The largest 3D view shows RayBatch's picture, in perspective."""
    there = view()
    space = there["space_data"]
    space.shading.type = "RENDERED"
    space.show_region_toolbar = space.show_region_ui = False
    space.region_3d.view_perspective = "PERSP"
    space.region_3d.view_location = (4.5, 3.0, 0.0)
    space.region_3d.view_distance = 14.0


def every(seconds: float, step: Callable[[], bool], is_good: Callable[[], bool] = lambda: True) -> None:
    """Call `step` every `seconds` from Blender's main loop until it returns True; then Blender is closed, with the exit
    code 1 where not `is_good`, as after an error.
    """

    def call() -> float | None:
        try:
            if not step():
                return seconds
        except (Exception, SystemExit) as error:  # Python's own end, within a callback, frees textures of the window
            if isinstance(error, SystemExit):
                print(error, file=sys.stderr)
            else:
                traceback.print_exc()
            sys.stdout.flush()
            os._exit(1)
        sys.stdout.flush()
        if not is_good():
            os._exit(1)
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(call, first_interval=2.0, persistent=True)  # also behind another file


def write(path: str, report: dict[str, Any]) -> None:
    """Write `report` as JSON, and print it."""
    text = json.dumps(report, indent=1)
    Path(path).write_text(text + "\n", encoding="utf-8")
    print(text)
