"""The plot as it is shown: in an image, in icons of panels, and drawn again while renders run."""

from __future__ import annotations

import traceback

import bpy
import bpy.utils.previews

from ...blender.result import write_image, write_preview
from ...convergence.plot import SLOT_COLORS, draw_plot
from ...convergence.records import RUNNING, store
from .properties import chosen_target

IMAGE_NAME = "RayBatch Convergence"
# Size of the image, and the height of its capital letters [pixels]
IMAGE_SIZE, IMAGE_TEXT = (1280, 960), 12.0
# Between two looks at the record while a render runs, and otherwise [s]
LIVE_SECONDS, IDLE_SECONDS = 0.5, 1.0


class Shown:
    """State that was drawn last, so that nothing is drawn twice; touched by the main thread alone."""

    previews: bpy.utils.previews.ImagePreviewCollection | None = None  # icons of the slots, and the plot in the panel
    panels: dict[str, tuple] = {}  # what the plot in each editor's panel shows
    image: tuple | None = None  # what the image shows
    followed: tuple | None = None  # what panels last showed
    seen = False  # the panel is open somewhere


def _previews() -> bpy.utils.previews.ImagePreviewCollection:
    assert Shown.previews is not None, "the add-on is not enabled"
    return Shown.previews


def _state(scene: bpy.types.Scene) -> tuple:
    return store.version, round(chosen_target(scene), 12)


def update_image(scene: bpy.types.Scene) -> bpy.types.Image:
    """Draw the plot into the image `RayBatch Convergence`, which is made if need be. For the main thread."""
    image = bpy.data.images.get(IMAGE_NAME)
    state = _state(scene)
    if image is None or Shown.image != state:
        image = write_image(IMAGE_NAME, draw_plot(store.runs(), chosen_target(scene), *IMAGE_SIZE, IMAGE_TEXT))
        Shown.image = state
    if image.is_dirty and not _is_busy():
        image.pack()  # or Blender asks to save it when it is closed
    return image


def panel_icon(scene: bpy.types.Scene, editor: int, edge: int, text_size: float) -> int:
    """The icon that is the plot in `editor`, `edge` pixels wide and high."""
    name = _icon_name(editor)
    previews = _previews()
    preview = previews[name] if name in previews else previews.new(name)
    state = (*_state(scene), edge, text_size)
    if Shown.panels.get(name) != state:
        write_preview(preview, draw_plot(store.runs(), chosen_target(scene), edge, edge, text_size))
        Shown.panels[name] = state
    return preview.icon_id


def _icon_name(editor: int) -> str:
    return f"plot {editor}"


def slot_icon(slot: int) -> int:
    """A square in the colour of a slot."""
    name = f"slot {slot}"
    previews = _previews()
    if name not in previews:
        preview = previews.new(name)
        preview.icon_size = (16, 16)
        pixels = [(0.0, 0.0, 0.0, 0.0)] * 256
        for i in range(256):
            if 3 <= i % 16 < 13 and 3 <= i // 16 < 13:
                pixels[i] = (*SLOT_COLORS[slot % len(SLOT_COLORS)], 1.0)
        preview.icon_pixels_float = [value for pixel in pixels for value in pixel]
    return previews[name].icon_id


def _is_busy() -> bool:
    """A render goes on, perhaps between two frames."""
    return any(run.state == RUNNING for run in store.runs()) or bpy.app.is_job_running("RENDER")


def plot_editors(windows) -> list[tuple[bpy.types.Window, bpy.types.Area]]:
    """The image editors that show the plot."""
    editors = [(window, area) for window in windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
    return [
        (window, area) for window, area in editors if (image := area.spaces.active.image) and image.name == IMAGE_NAME
    ]


def follow() -> float:
    """Show what renders have recorded meanwhile; Blender calls it on the main thread, where its data may be written."""
    busy = _is_busy()
    try:
        windows = [window for manager in bpy.data.window_managers for window in manager.windows]
        watching = plot_editors(windows)
        state = (busy, len(watching), *(_state(window.scene) for window in windows))
        if windows and state != Shown.followed:
            Shown.followed = state
            if watching or (Shown.seen and store.runs() and not busy):
                update_image((watching[0][0] if watching else windows[0]).scene)
            panels = [area for window in windows for area in window.screen.areas if area.type == "PROPERTIES"]
            _show_again(panels + [area for _, area in watching])
    except Exception:  # or Blender would not call it again
        traceback.print_exc()
        return 10.0
    return LIVE_SECONDS if busy else IDLE_SECONDS


def _show_again(areas: list[bpy.types.Area]) -> None:
    """Let `areas` be drawn again; and forget the plots of editors that were closed."""
    Shown.seen = False
    for area in areas:
        area.tag_redraw()
    there = {
        _icon_name(region.as_pointer())
        for screen in bpy.data.screens
        for area in screen.areas
        for region in area.regions
    }
    for name in Shown.panels.keys() - there:
        del _previews()[name], Shown.panels[name]


@bpy.app.handlers.persistent
def forget_image(*_) -> None:
    """After another file was opened, or an undo: the image is as it was then."""
    Shown.image = Shown.followed = None
