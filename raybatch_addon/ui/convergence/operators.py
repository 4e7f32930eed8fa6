"""Operators on the runs that the panel Convergence lists, and on their plot."""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from ...convergence.records import SLOT_COUNT, store
from ...convergence.run_data import runs_as_data
from ...core.files import whole_file
from ..panel import is_engine
from .properties import chosen_target
from .shown import plot_editors, update_image


class _Operator(bpy.types.Operator):
    """Base of the operators: there while RayBatch is the engine and there are runs."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context):
        return is_engine(context) and bool(store.runs())


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
            self.report(
                {"ERROR"}, f"one of the {SLOT_COUNT} slots must be left for the next render: let another run go first"
            )
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
        if plot_editors(context.window_manager.windows):
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
    return (
        json.dumps(runs_as_data(store.runs(), chosen_target(scene)), indent=1, allow_nan=False, ensure_ascii=False)
        + "\n"
    )


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
        try:
            with whole_file(path) as temporary:
                temporary.write_bytes(data)
        except OSError as error:
            self.report({"ERROR"}, f"cannot write {path}: {error.strerror}; choose another place")
            return {"CANCELLED"}
        return {"FINISHED"}
