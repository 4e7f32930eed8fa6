"""The panel Convergence: error and rays a second over time of the last renders, live and to compare."""

from __future__ import annotations

import contextlib
import json
import os
import traceback
from pathlib import Path

import bpy
import bpy.utils.previews

from ..convergence import RUNNING, SLOT_COUNT, Run, names_of, run_lines, runs_as_data, store, target_line
from ..convergence_plot import SLOT_COLORS, draw_plot
from ..result import write_image, write_preview
from .panel import ENGINE, EnginePanel, draw_lines

IMAGE_NAME = "RayBatch Convergence"
# Of the image [pixels], and the height of its capital letters
IMAGE_SIZE, IMAGE_TEXT = (1280, 960), 12.0
# Of the plot in the panel, at scale 1
_PANEL_TEXT, _PANEL_EDGE_MAX = 6.0, 640
_UNIT = 20  # pixels of Blender's icons at scale 1
# Between two looks at the record while a render runs, and otherwise [s]
_LIVE_SECONDS, _IDLE_SECONDS = 0.5, 1.0


class RayBatchConvergence(bpy.types.PropertyGroup):
    """What the panel Convergence remembers of a scene."""

    record: bpy.props.BoolProperty(
        name="Record Renders", default=False, options=set(),
        description="Keep rays a second over time of each render. Error over time is kept as well, and without this, where Error Estimate is on",
    )  # fmt: skip
    target: bpy.props.FloatProperty(
        name="Error to Reach", default=0.001, min=1e-9, max=1e9, precision=6, options=set(),
        description="The error (relMSE) to which the time is told; that of Stop at Error, where there is one",
    )  # fmt: skip


def chosen_target(scene: bpy.types.Scene) -> float:
    """The relMSE to which the time is told."""
    return scene.raybatch.error_target or scene.raybatch_convergence.target


# --- the plot


class _Shown:
    """What was drawn last, so that nothing is drawn twice; touched by the main thread alone."""

    previews = None  # icons of the slots, and the plot in the panel
    panels: dict[str, tuple] = {}  # what the plot in each editor's panel shows
    image: tuple | None = None  # what the image shows
    followed: tuple | None = None  # what panels were last told to show
    seen = False  # the panel is open somewhere


def _state(scene: bpy.types.Scene) -> tuple:
    return store.version, round(chosen_target(scene), 12)


def update_image(scene: bpy.types.Scene) -> bpy.types.Image:
    """Draw the plot into the image `RayBatch Convergence`, which is made if need be. For the main thread."""
    image = bpy.data.images.get(IMAGE_NAME)
    state = _state(scene)
    if image is None or _Shown.image != state:
        image = write_image(IMAGE_NAME, draw_plot(store.runs(), chosen_target(scene), *IMAGE_SIZE, IMAGE_TEXT))
        _Shown.image = state
    if image.is_dirty and not _is_busy():
        image.pack()  # or Blender asks to save it when it is closed
    return image


def _panel_icon(scene: bpy.types.Scene, editor: int, edge: int, text_size: float) -> int:
    """The icon that is the plot in `editor`, `edge` pixels wide and high."""
    name = _icon_name(editor)
    preview = _Shown.previews[name] if name in _Shown.previews else _Shown.previews.new(name)
    state = (*_state(scene), edge, text_size)
    if _Shown.panels.get(name) != state:
        write_preview(preview, draw_plot(store.runs(), chosen_target(scene), edge, edge, text_size))
        _Shown.panels[name] = state
    return preview.icon_id


def _icon_name(editor: int) -> str:
    return f"plot {editor}"


def _slot_icon(slot: int) -> int:
    """A square in the colour of a slot."""
    name = f"slot {slot}"
    if name not in _Shown.previews:
        preview = _Shown.previews.new(name)
        preview.icon_size = (16, 16)
        pixels = [(0.0, 0.0, 0.0, 0.0)] * 256
        for i in range(256):
            if 3 <= i % 16 < 13 and 3 <= i // 16 < 13:
                pixels[i] = (*SLOT_COLORS[slot % len(SLOT_COLORS)], 1.0)
        preview.icon_pixels_float = [value for pixel in pixels for value in pixel]
    return _Shown.previews[name].icon_id


def _is_busy() -> bool:
    """A render goes on, perhaps between two frames."""
    return any(run.state == RUNNING for run in store.runs()) or bpy.app.is_job_running("RENDER")


def _watching(windows) -> list[tuple[bpy.types.Window, bpy.types.Area]]:
    """The image editors that show the plot."""
    editors = [(window, area) for window in windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
    return [(window, area) for window, area in editors if (image := area.spaces.active.image) and image.name == IMAGE_NAME]


def _follow() -> float:
    """Show what renders have recorded meanwhile; Blender calls it on the main thread, where its data may be written."""
    busy = _is_busy()
    try:
        windows = [window for manager in bpy.data.window_managers for window in manager.windows]
        watching = _watching(windows)
        state = (busy, len(watching), *(_state(window.scene) for window in windows))
        if windows and state != _Shown.followed:
            _Shown.followed = state
            if watching or _Shown.seen and store.runs() and not busy:
                update_image((watching[0][0] if watching else windows[0]).scene)
            panels = [area for window in windows for area in window.screen.areas if area.type == "PROPERTIES"]
            _show_again(panels + [area for _, area in watching])
    except Exception:  # or Blender would not call it again
        traceback.print_exc()
        return 10.0
    return _LIVE_SECONDS if busy else _IDLE_SECONDS


def _show_again(areas: list[bpy.types.Area]) -> None:
    """Let `areas` be drawn again; and forget the plots of editors that were closed."""
    _Shown.seen = False
    for area in areas:
        area.tag_redraw()
    there = {_icon_name(region.as_pointer()) for screen in bpy.data.screens for area in screen.areas for region in area.regions}
    for name in _Shown.panels.keys() - there:
        del _Shown.previews[name], _Shown.panels[name]


@bpy.app.handlers.persistent
def _forget_image(*_) -> None:
    """After another file was opened, or an undo: the image is as it was then."""
    _Shown.image = _Shown.followed = None


# --- operators


class _Operator(bpy.types.Operator):
    """What the operators share."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context):
        return context.scene is not None and context.engine == ENGINE and bool(store.runs())


class RAYBATCH_OT_convergence_keep(_Operator):
    """Keep this run: newer ones leave its slot alone. Click again to let it go"""

    bl_idname = "raybatch.convergence_keep"
    bl_label = "Keep Run"

    run: bpy.props.IntProperty(name="Run", description="Its number")

    def execute(self, _context):
        kept = next((run.kept for run in store.runs() if run.number == self.run), None)
        if kept is None:
            self.report({"ERROR"}, f"there is no run {self.run} any more")
            return {"CANCELLED"}
        if not store.keep(self.run, not kept):
            self.report({"ERROR"}, f"one of the {SLOT_COUNT} slots must be left for the next render: let another run go first")
            return {"CANCELLED"}
        return {"FINISHED"}


class RAYBATCH_OT_convergence_hide(_Operator):
    """Show this run in the plot, or hide it"""

    bl_idname = "raybatch.convergence_hide"
    bl_label = "Show or Hide Run"

    run: bpy.props.IntProperty(name="Run", description="Its number")

    def execute(self, _context):
        shown = next((run.shown for run in store.runs() if run.number == self.run), None)
        if shown is None or not store.change(self.run, shown=not shown):
            self.report({"ERROR"}, f"there is no run {self.run} any more")
            return {"CANCELLED"}
        return {"FINISHED"}


class RAYBATCH_OT_convergence_clear(_Operator):
    """Clear the slot of this run"""

    bl_idname = "raybatch.convergence_clear"
    bl_label = "Clear Run"

    run: bpy.props.IntProperty(name="Run", description="Its number; 0 clears all", default=0)

    @classmethod
    def description(cls, _context, properties):
        return "Clear the slot of this run" if properties.run else "Clear all slots"

    def execute(self, _context):
        store.clear(self.run or None)
        return {"FINISHED"}


class RAYBATCH_OT_convergence_plot(_Operator):
    """Show the plot in an image editor; it goes on while renders run"""

    bl_idname = "raybatch.convergence_plot"
    bl_label = "Show Plot"

    def execute(self, context):
        image = update_image(context.scene)
        if bpy.app.background:  # there are no windows
            self.report({"INFO"}, f"the plot is in the image “{image.name}”")
            return {"FINISHED"}
        if _watching(context.window_manager.windows):
            return {"FINISHED"}
        window = context.window
        editors = [area for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
        if not editors:
            bpy.ops.wm.window_new()
            window = context.window_manager.windows[-1]
            editors = list(window.screen.areas)[:1]
            editors[0].type = "IMAGE_EDITOR"
        editors[0].spaces.active.image = image
        region = next(region for region in editors[0].regions if region.type == "WINDOW")
        with context.temp_override(window=window, area=editors[0], region=region):
            bpy.ops.image.view_all(fit_view=True)
        return {"FINISHED"}


def _json_text(scene: bpy.types.Scene) -> str:
    return json.dumps(runs_as_data(store.runs(), chosen_target(scene)), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


class RAYBATCH_OT_convergence_copy(_Operator):
    """Copy all runs as JSON: settings, errors and rays a second over time"""

    bl_idname = "raybatch.convergence_copy"
    bl_label = "Copy as JSON"

    def execute(self, context):
        context.window_manager.clipboard = _json_text(context.scene)
        return {"FINISHED"}


class RAYBATCH_OT_convergence_save(_Operator):
    """Save all runs as JSON: settings, errors and rays a second over time"""

    bl_idname = "raybatch.convergence_save"
    bl_label = "Save as JSON"

    filepath: bpy.props.StringProperty(name="File", subtype="FILE_PATH")
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def invoke(self, context, _event):
        self.filepath = self.filepath or "convergence.json"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        if not self.filepath:
            self.report({"ERROR"}, "no file is named: give `filepath`")
            return {"CANCELLED"}
        path = Path(bpy.path.ensure_ext(bpy.path.abspath(self.filepath), ".json")).absolute()
        data = _json_text(context.scene).encode()
        beside = path.with_name(f".{os.getpid()}.{path.name}")  # nothing is left half-written
        try:
            beside.write_bytes(data)
            os.replace(beside, path)
        except OSError as error:
            self.report({"ERROR"}, f"cannot write {path}: {error.strerror}; choose another place")
            return {"CANCELLED"}
        finally:
            with contextlib.suppress(OSError):  # it is in its place, or was never made
                beside.unlink()
        return {"FINISHED"}


# --- the panel


class RAYBATCH_RENDER_PT_convergence(EnginePanel, bpy.types.Panel):
    """Error and rays a second over time, of the running render and of the last ones."""

    bl_label = "Convergence"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        _Shown.seen = True
        scene, layout = context.scene, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        row = layout.row()
        row.active = not _estimates_error(scene)  # or it is recorded anyway
        row.prop(scene.raybatch_convergence, "record")
        if scene.raybatch.error_target > 0:
            layout.prop(scene.raybatch, "error_target")
        else:
            layout.prop(scene.raybatch_convergence, "target")
        runs = store.runs()
        if not runs:
            draw_lines(layout, context, [_hint(scene)], "INFO")
            return
        scale = context.preferences.system.ui_scale
        edge = min(context.region.width / scale - 2 * _UNIT, _PANEL_EDGE_MAX)
        if edge >= 5 * _UNIT:
            icon = _panel_icon(scene, context.region.as_pointer(), round(edge * scale), _PANEL_TEXT * scale)
            layout.template_icon(icon_value=icon, scale=edge / _UNIT)
        draw_lines(layout, context, run_lines(runs[0], chosen_target(scene)))
        _draw_slots(layout, runs, chosen_target(scene))
        row = layout.row(align=True)
        row.operator(RAYBATCH_OT_convergence_plot.bl_idname, text="Show Plot", icon="IMAGE_DATA")
        row.operator(RAYBATCH_OT_convergence_copy.bl_idname, text="", icon="COPYDOWN")
        row.operator(RAYBATCH_OT_convergence_save.bl_idname, text="", icon="FILE_TICK")
        row.operator(RAYBATCH_OT_convergence_clear.bl_idname, text="", icon="TRASH").run = 0


def _estimates_error(scene: bpy.types.Scene) -> bool:
    return scene.raybatch.error_estimate == "ON" or scene.raybatch.error_target > 0


def _hint(scene: bpy.types.Scene) -> str:
    if _estimates_error(scene):
        return "The next render is recorded, with its error"
    if scene.raybatch_convergence.record:
        return "Rays a second of the next render are recorded. For its error turn on Error Estimate in Sampling"
    return "Nothing is recorded: turn on Error Estimate in Sampling, or Record Renders for rays a second alone"


def _draw_slots(layout, runs: list[Run], target: float) -> None:
    """A line for each run: its colour and name, when it reaches the target, and buttons."""
    names = names_of(runs)
    column = layout.column(align=True)
    for run in runs:
        row = column.row(align=True)
        row.label(text=names[run.number], icon_value=_slot_icon(run.slot))
        for operator, icon, depress in (
            (RAYBATCH_OT_convergence_hide, "HIDE_OFF" if run.shown else "HIDE_ON", False),
            (RAYBATCH_OT_convergence_keep, "PINNED" if run.kept else "UNPINNED", run.kept),
            (RAYBATCH_OT_convergence_clear, "X", False),
        ):
            row.operator(operator.bl_idname, text="", icon=icon, depress=depress).run = run.number
        if len(runs) > 1 and run.points and run is not runs[0]:
            column.label(text=target_line(run, target), icon="BLANK1")


_classes = (
    RayBatchConvergence, RAYBATCH_OT_convergence_keep, RAYBATCH_OT_convergence_hide, RAYBATCH_OT_convergence_clear,
    RAYBATCH_OT_convergence_plot, RAYBATCH_OT_convergence_copy, RAYBATCH_OT_convergence_save, RAYBATCH_RENDER_PT_convergence,
)  # fmt: skip


def _handlers() -> tuple[list, ...]:
    return bpy.app.handlers.load_post, bpy.app.handlers.undo_post, bpy.app.handlers.redo_post


def register() -> None:
    """Add the panel, its operators and what it remembers; and look at the record from now on."""
    for cls in _classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.raybatch_convergence = bpy.props.PointerProperty(
        type=RayBatchConvergence, name="RayBatch Convergence", description="What the panel Convergence remembers"
    )
    _Shown.previews = bpy.utils.previews.new()
    for handlers in _handlers():
        handlers.append(_forget_image)
    if not bpy.app.background:
        bpy.app.timers.register(_follow, first_interval=_IDLE_SECONDS, persistent=True)


def unregister() -> None:
    """Remove all of it, and forget the runs."""
    if bpy.app.timers.is_registered(_follow):
        bpy.app.timers.unregister(_follow)
    for handlers in _handlers():
        handlers.remove(_forget_image)
    bpy.utils.previews.remove(_Shown.previews)
    _Shown.previews = _Shown.image = _Shown.followed = None
    _Shown.panels.clear()
    store.clear()
    del bpy.types.Scene.raybatch_convergence
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
