"""A viewport: between Blender's callbacks, the scene that is read in them, and the thread that renders it."""

from __future__ import annotations

import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import bpy

from ...core.denoise.picture import guiding_passes
from ...core.errors import RayBatchError
from ...core.live.picture import LiveRequest
from ...core.live.render import LiveRender, LiveState, SessionSource
from ...core.scene.cameras import Camera
from ...core.scene.description import Frame, Scene
from ...core.settings.settings import RenderSettings
from ...export.live.edits import updates_of
from ...export.live.live_scene import LiveScene
from ...export.live.settings import live_settings, pixel_side
from ...export.live.view3d import camera_of, live_camera, region_view
from ...export.settings import exposure_of
from .. import finals
from ..denoise_library import library_for
from ..sessions import ViewSessions
from .draw import PictureTexture

# Reading the scene pauses after the object during which so much time has passed in one callback [s]
SLICE_SECONDS = 0.02
# Time between two looks whether a final render has read its scene [s]
LOCKED_SECONDS = 0.2

# All that are there: they end before sessions are closed
_open: weakref.WeakSet[Viewport] = weakref.WeakSet()


class Viewport:
    """The picture that one render engine of Blender's shows in one region of the 3D view."""

    def __init__(self, redraw: Callable[[], None], source: SessionSource | None = None) -> None:
        """`redraw` asks Blender for a `draw`; it is called on any thread."""
        self._redraw = redraw
        self.live = LiveScene()
        self._sessions = source or ViewSessions()
        self.render = LiveRender(self._sessions, redraw)
        self._shown: tuple[Any, ...] | None = None  # what the last request was made of
        self._space_state: tuple[Any, ...] | None = None
        self._source: tuple[int, str] | None = None  # `session_uid` of the scene that is read, and its view layer
        self._scene: Scene | None = None  # of the last request: while it is held, no other has its identity
        self._number = 0
        self._was_deleted = False  # something of Blender's, while the scene was read last
        self._timer: threading.Timer | None = None  # until it is drawn again, where that need not be at once
        self.is_closed = False
        self._error = ""  # why the scene could not be read
        self._exposure = 1.0
        self._texture = PictureTexture()
        self.seconds: deque[float] = deque(maxlen=1000)  # that the last callbacks took
        _open.add(self)

    # --- Blender's callbacks

    def update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """The scene was edited."""
        start = time.perf_counter()
        try:
            self.live.note(updates_of(depsgraph))
        except Exception:  # what was edited is not known, but it was
            self.live.forget()
        self._read(context, depsgraph)
        self.seconds.append(time.perf_counter() - start)

    def draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """The region is to be drawn: read on, and draw the newest picture there is."""
        start = time.perf_counter()
        finals.look()
        self._read(context, depsgraph)
        picture = self.render.picture
        if picture is not None:
            try:
                self._texture.draw(engine, depsgraph.scene, picture, self._exposure)
                self.render.note_drawn(picture)
            except Exception as error:  # of the driver: a traceback at each draw would help nobody
                self._error = f"the picture could not be drawn: {type(error).__name__}: {error}"
        self.seconds.append(time.perf_counter() - start)

    def status(self) -> tuple[str, str]:
        """Two lines for the corner of the view."""
        state = self.render.state
        if self._error or state.error:
            return "RayBatch", self._error or state.error
        if not self.live.is_current:
            return "RayBatch", "Reading the scene"
        return "RayBatch", with_warnings(live_status(state), [*self.live.warnings, *self.render.warnings])

    def close(self) -> None:
        """End soon, without waiting."""
        self.is_closed = True
        if self._timer is not None:
            self._timer.cancel()
        self.render.close()

    def open_again(self) -> None:
        """Undo `close`."""
        self.is_closed, self._shown = False, None
        self.render = LiveRender(self._sessions, self._redraw)

    # --- reading

    def _read(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Read a slice of what was edited, and have it rendered once all is read."""
        try:
            self._read_slice(context, depsgraph)
            self._error, self._was_deleted = "", False
        except RayBatchError as error:
            self._error = " ".join(str(error).split())
        except ReferenceError:
            if not self._was_deleted:  # something was deleted meanwhile: look once more, unless an update follows
                self._was_deleted = True
                self._redraw()
        except Exception as error:  # a traceback at each draw would help nobody
            self._error = f"the scene could not be read: {type(error).__name__}: {error}"

    def _read_slice(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        space, scene = context.space_data, depsgraph.scene
        source = (scene.original.session_uid, depsgraph.view_layer.name)
        if source != self._source:  # the window shows another scene, of which nothing need be evaluated anew
            self._source = source
            self.live.forget()
        space_state = _state_of(space)
        if space_state != self._space_state:
            self._space_state = space_state
            self.live.look_again()
        self.live.read(depsgraph, space, SLICE_SECONDS)
        if not self.live.is_current:
            if self.live.is_locked:
                self._redraw_later()
            else:
                self._redraw()  # go on in the next callback
            return
        if self.live.scene is None:
            return
        view = region_view(context.region, space, scene)
        camera, frame = live_camera(view, camera_of(space, scene), depsgraph, self.live.scene.frame)
        settings = live_settings(scene)
        self._exposure = exposure_of(scene)
        self._show(self.live.scene, camera, frame, settings, pixel_side(scene, context.preferences.system.pixel_size))

    def _redraw_later(self) -> None:
        if not self.is_closed and (self._timer is None or not self._timer.is_alive()):
            self._timer = threading.Timer(LOCKED_SECONDS, self._redraw)
            self._timer.daemon = True
            self._timer.start()

    def _show(self, scene: Scene, camera: Camera, frame: Frame | None, settings: RenderSettings, side: int) -> None:
        """Have this rendered, unless it is what was asked for last."""
        if frame is None or min(frame.width, frame.height) < 1:  # the render region is outside of the view
            self._shown = self._scene = None
            self.render.drop()
            return
        made_of = (id(scene), _values_of(camera), frame, settings, side)
        if made_of == self._shown:
            return
        denoiser = library_for(settings)  # an error of it is shown as long as it is there
        self._shown = made_of
        self._number += 1
        passes = tuple(dict.fromkeys((*frame.passes, *guiding_passes(settings))))
        whole = replace(scene, camera=camera, frame=replace(frame, passes=passes))
        self._scene = scene
        self.render.show(LiveRequest(self._number, whole, settings, side, denoiser))


def live_status(state: LiveState) -> str:
    """One line on where a live render stands."""
    samples = f"Sample {int(state.samples)}/{state.samples_total}"
    if not state.stage:
        return samples if state.samples_total else ""
    memory = f" | Memory {state.memory_bytes / 2**20:.0f} MB" if state.memory_bytes else ""
    if state.stage != "Rendering":
        return state.stage + memory
    return samples + memory + (" | compiling specialised kernels" if state.compiles else "")


def with_warnings(text: str, warnings: Sequence[str]) -> str:
    """`text` with the first of `warnings`, and how many more there are."""
    reported = list(dict.fromkeys(warnings))
    if not reported:
        return text
    more = f" (and {len(reported) - 1} more)" if len(reported) > 1 else ""
    return " | ".join(filter(None, (text, f"{reported[0]}{more}")))


def end_viewports() -> list[Viewport]:
    """End all viewports soon, and return them."""
    viewports = list(_open)
    for viewport in viewports:
        viewport.close()
    return viewports


def close_viewports(seconds: float = 10.0) -> None:
    """End all viewports, and wait for their threads."""
    viewports = end_viewports()
    for viewport in viewports:
        viewport.render.join(seconds)


def _values_of(camera: Camera) -> tuple[Any, ...]:
    values = dict(vars(camera))
    return (values.pop("transform").tobytes(), *values.values())


def _state_of(space: bpy.types.SpaceView3D) -> tuple[Any, ...]:
    """What of a 3D view decides which objects it shows, and of which Blender reports nowhere."""
    kinds = [name for name in space.bl_rna.properties.keys() if name.startswith("show_object_viewport_")]
    return (space.local_view is not None, space.use_local_collections, tuple(getattr(space, name) for name in kinds))
