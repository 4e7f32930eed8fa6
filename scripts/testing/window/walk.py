"""The walk of docs/manual/first-render.md through Blender's window, and the panels, with the manual's pictures of them.

    blender --window-geometry 0 0 W H --python scripts/testing/window/walk.py -- FOLDER [STEP ...]

Does each STEP (default: all, in their order) as a user does, by mouse and keys (xdotool, so on X11 alone), operators
and properties, and saves its pictures in FOLDER, under the names that docs/manual has them by. The scene is the
script's own, and is saved there too, with its checkpoint. A step that is not seen to happen within minutes is an error.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
import hands
import pictures
import watched
from pictures import Box, Pictures, box_of
from render_tab import RenderTab

FRAME = "blender.frame"  # the end of the name of RayBatch's module of final renders, however it was installed
WAIT_SECONDS = 600.0  # for anything at most
FULL_WIDTH = 1100  # of pictures of the whole window [pixels]
SAMPLES, SMALL_SAMPLES = 40, 16
PANELS = (
    "device",
    "sampling",
    "denoising",
    "light_paths",
    "film",
    "checkpoint",
    "viewport",
    "performance",
    "batching",
    "before_render",
    "last_render",
    "cluster",
    "compare",
    "convergence",
)

Wait = float | Callable[[], bool]  # seconds, or until it is true


class Walk:
    """The steps, each a method that yields what to wait for."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self.folder = folder
        self.pictures = Pictures(folder)
        self.watch, self._watches = watched.Watch(), False
        self.samples = 0.0  # of the final render, so far
        self._listens = False
        self._wait: Wait = 0.0
        self._since = time.monotonic()
        steps = [("prepare", self.prepare), *((name, getattr(self, name)) for name in names)]
        self._parts = itertools.chain.from_iterable(self._told(name, step) for name, step in steps)

    def step(self) -> bool:
        """What comes next, unless something is waited for; True at the end."""
        self._listen()
        waited = time.monotonic() - self._since
        if callable(self._wait):
            if not self._wait():
                if waited > WAIT_SECONDS:
                    raise TimeoutError(f"nothing after {waited:.0f} s")
                return False
        elif waited < self._wait:
            return False
        try:
            self._wait = next(self._parts)
        except StopIteration:
            self.pictures.save()
            return True
        self._since = time.monotonic()
        return False

    def _told(self, name: str, step: Callable[[], Iterator[Wait]]) -> Iterator[Wait]:
        print(f"{name}:", flush=True)
        yield from step()

    def _listen(self) -> None:
        """Note what viewport and final renders do, once their modules are there."""
        self._watches = self._watches or self.watch.begin()
        module: Any = next((each for name, each in sys.modules.items() if name.endswith(FRAME)), None)
        if not self._listens and hasattr(module, "progress_listeners"):
            module.progress_listeners.append(self._note)
            self._listens = True

    def _note(self, progress: Any) -> None:
        self.samples = progress.samples_done

    # --- what steps are made of

    @property
    def screen(self) -> Box:
        """All editors of the window."""
        return box_of(*bpy.context.window_manager.windows[0].screen.areas)

    @property
    def middle(self) -> tuple[float, float]:
        """The middle of the largest editor: of the 3D view, or of the image that is in its place."""
        area = max(bpy.context.window_manager.windows[0].screen.areas, key=lambda each: each.width * each.height)
        return area.x + 0.5 * area.width, area.y + 0.5 * area.height

    def take(self, name: str) -> None:
        """A picture of the whole window."""
        self.pictures.take(name, self.screen, FULL_WIDTH)

    def seen(self, samples: int) -> Callable[[], bool]:
        """Whether the viewport shows so many samples of what it is asked for."""

        def is_seen() -> bool:
            picture = self.watch.viewport.render.picture if self.watch.viewport else None
            if picture is None or picture.request.number != self.watch.asked:
                return False
            return picture.side == 1 and picture.samples >= samples

        return is_seen

    def render(self) -> Iterator[Wait]:
        """Press F12, and wait until the render has begun."""
        hands.place(*self.middle)
        self.samples = 0.0
        hands.press("F12")
        yield is_rendering

    def reached(self, samples: float) -> Callable[[], bool]:
        """Whether the final render has so many samples."""
        return lambda: self.samples >= samples

    def run(self, operator: Any, **options: object) -> None:
        """Call an operator as its button does."""
        window = bpy.context.window_manager.windows[0]
        with bpy.context.temp_override(window=window, screen=window.screen, area=self.tab.area, region=self.tab.region):
            operator("INVOKE_DEFAULT", **options)

    # --- steps

    def prepare(self) -> Iterator[Wait]:
        """The scene, the view through its camera, and Blender's window as it is at first."""
        make_scene(self.folder)
        there = watched.view()
        there["region_data"].view_perspective = "CAMERA"
        there["space_data"].shading.type = "SOLID"
        with bpy.context.temp_override(**there):
            bpy.ops.view3d.view_center_camera()  # Home
        self.tab = RenderTab(self.pictures)
        self.tab.turn_to()
        yield 1.0

    def engine(self) -> Iterator[Wait]:
        """1. Choose the engine."""
        bpy.context.scene.render.engine = "BLENDER_EEVEE"
        yield 1.0
        self.tab.click_engine()
        yield 3.0
        right, top = self.screen.x1, self.screen.y1
        self.pictures.take("choose-engine", Box(right - 700, top - 540, right, top))
        hands.press("r")  # the letter that is underlined
        yield lambda: bpy.context.scene.render.engine == "RAYBATCH"

    def viewport(self) -> Iterator[Wait]:
        """2. Look at it in the viewport."""
        watched.view()["space_data"].shading.type = "RENDERED"
        yield self.seen(2)
        self.take("viewport")

    def orbit(self) -> Iterator[Wait]:
        """2. Turn the view with the middle mouse button."""
        across, up = self.middle
        hands.place(across, up)
        yield 0.3
        hands.begin_drag()
        for step in range(1, 31):
            hands.place(across + 6 * step, up + step)
            if step == 20:
                self.pictures.take("orbit", box_of(watched.view()["area"]), 800)
            yield 0.15
        hands.end_drag()
        yield self.seen(1)
        watched.view()["region_data"].view_perspective = "CAMERA"
        yield self.seen(1)

    def colour(self) -> Iterator[Wait]:
        """3. Change a colour."""
        hands.click(*self.middle)
        yield lambda: bpy.context.view_layer.objects.active.name == "Head"
        self.tab.turn_to("MATERIAL")
        yield 1.0
        nodes = bpy.context.active_object.active_material.node_tree.nodes
        nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.02, 0.15, 0.8, 1.0)
        yield 0.5
        yield self.seen(2)
        self.take("colour")
        self.tab.turn_to()
        yield 0.5

    def final(self) -> Iterator[Wait]:
        """4 and 5. Render, stop, and go on."""
        bpy.context.scene.raybatch_checkpoint.use = True
        yield from self.tab.open_alone("RAYBATCH_RENDER_PT_checkpoint")
        yield from self.render()
        yield self.reached(1.5)  # the first sample of all tiles has been drawn by then
        yield 1.0
        self.take("render-early")
        yield self.reached(12)
        yield 0.5
        self.take("render-later")
        yield self.reached(16)
        hands.press("Escape")
        yield is_idle
        yield 1.0
        self.take("stopped")
        done = self.samples
        yield from self.render()
        yield self.reached(done)
        yield 1.0
        self.take("resumed")
        yield is_idle

    def last(self) -> Iterator[Wait]:
        """6. See what it took."""
        yield from self.tab.open_alone("RAYBATCH_RENDER_PT_last_render")
        yield from self.tab.take_tab("last-render", "RAYBATCH_RENDER_PT_last_render")

    def compare(self) -> Iterator[Wait]:
        """7. Compare two renders."""
        scene = bpy.context.scene
        scene.raybatch_checkpoint.use = False
        yield from self.tab.open_alone("RAYBATCH_RENDER_PT_compare")
        scene.raybatch.sample_count = SMALL_SAMPLES
        self.run(bpy.ops.raybatch.render_in_new_slot)
        yield is_rendering
        yield is_idle
        yield 1.0
        self.take("compare")

    def tune(self) -> Iterator[Wait]:
        """8. Find what is fastest."""
        yield from self.tab.open_alone("RAYBATCH_RENDER_PT_performance")
        self.run(bpy.ops.raybatch.tune)
        yield is_rendering
        yield is_idle
        yield 1.0
        yield from self.tab.scroll_to_end()
        self.take("tune")

    def panels(self) -> Iterator[Wait]:
        """Each panel, as three renders of different settings leave it."""
        scene = bpy.context.scene
        scene.render.engine = "RAYBATCH"
        scene.render.resolution_percentage = 50
        scene.raybatch.sample_count, scene.raybatch.error_estimate = SMALL_SAMPLES, "ON"
        self.run(bpy.ops.raybatch.tune)
        yield is_rendering
        yield is_idle
        for sequence in ("SOBOL", "INDEPENDENT", "BLUE_NOISE"):
            scene.raybatch.sample_sequence = sequence
            self.run(bpy.ops.raybatch.render_in_new_slot)
            yield is_rendering
            yield is_idle
        scene.raybatch.sample_sequence = "SOBOL"
        scene.cycles.samples = 512
        self.run(bpy.ops.raybatch.check_scene)
        scene.raybatch_checkpoint.use, scene.raybatch.denoise = True, "ON"
        for name in PANELS:
            picture = f"panel-{name.replace('_', '-')}"
            yield from self.tab.take_panel(picture, f"RAYBATCH_RENDER_PT_{name}")


STEPS = ("engine", "viewport", "orbit", "colour", "final", "last", "compare", "tune", "panels")


def is_rendering() -> bool:
    """Whether a final render is under way."""
    return bpy.app.is_job_running("RENDER")


def is_idle() -> bool:
    """Whether none is."""
    return not is_rendering()


def make_scene(folder: Path) -> None:
    """A head between a ball of glass and a column, floor and wall, a lamp and a camera; saved as head.blend."""
    for each in list(bpy.data.objects):
        bpy.data.objects.remove(each)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=60.0)
    _finish("Floor", _material("Paper", (0.55, 0.57, 0.6), roughness=0.7))
    bpy.ops.mesh.primitive_plane_add(size=60.0, location=(0.0, 5.0, 0.0), rotation=(math.radians(90), 0.0, 0.0))
    _finish("Wall", _material("Paint", (0.2, 0.3, 0.38), roughness=0.9))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, segments=64, ring_count=32, location=(-2.5, -1.0, 0.8))
    _finish("Ball", _material("Glass", (1.0, 1.0, 1.0), transmission=1.0, roughness=0.0))
    bpy.ops.mesh.primitive_cylinder_add(radius=0.6, depth=1.6, vertices=64, location=(2.4, 0.6, 0.8))
    _finish("Column", _material("Clay", (0.75, 0.16, 0.07), roughness=0.6))
    bpy.ops.mesh.primitive_monkey_add(size=2.4, location=(0.0, 0.0, 1.2), rotation=(math.radians(-12), 0.0, 0.3))
    head = _finish("Head", _material("Metal", (0.9, 0.55, 0.16), metallic=1.0, roughness=0.25))
    subdivision = head.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.data.energy, lamp.data.size = 900.0, 2.5
    lamp.location, lamp.rotation_euler = (-3.0, -3.5, 5.0), (math.radians(45), 0.0, math.radians(-40))
    bpy.context.collection.objects.link(lamp)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.0, -10.5, 2.7), (math.radians(82), 0.0, 0.0)
    bpy.context.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "RAYBATCH"
    scene.render.resolution_x, scene.render.resolution_y = 800, 450
    scene.raybatch.sample_count = SAMPLES
    scene.render.filepath = "//head"
    for each in folder.glob("head*"):  # the walk begins anew
        each.unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "head.blend"), check_existing=False)


def _material(name: str, color: tuple[float, float, float], **values: float) -> bpy.types.Material:
    names = {"metallic": "Metallic", "roughness": "Roughness", "transmission": "Transmission Weight"}
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*color, 1.0)
    for key, value in values.items():
        inputs[names[key]].default_value = value
    return material


def _finish(name: str, material: bpy.types.Material) -> bpy.types.Object:
    """The object that was just added, named, smooth, and of a material."""
    made = bpy.context.active_object
    made.name = made.data.name = name
    made.data.materials.append(material)
    if len(made.data.polygons) > 1:
        bpy.ops.object.shade_smooth_by_angle()
    made.select_set(False)
    return made


if __name__ == "__main__":
    given = watched.arguments()
    unknown = [name for name in given[1:] if name not in STEPS]
    if not given or unknown:
        raise SystemExit(f"walk.py: give a folder behind --, and steps of {', '.join(STEPS)}\n{__doc__}")
    hands.look_for_program()
    pictures.look_for_program()
    preferences = bpy.context.preferences
    preferences.use_preferences_save = False  # what is set here is not kept
    preferences.view.show_splash = False
    preferences.view.render_display_type = "AREA"  # in place of the 3D view
    chosen = Path(given[0]).resolve()
    chosen.mkdir(parents=True, exist_ok=True)
    watched.every(0.05, Walk(chosen, given[1:] or list(STEPS)).step)
