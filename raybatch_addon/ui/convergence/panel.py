"""The panel Convergence: the plot, and a line for each of the last renders."""

from __future__ import annotations

import bpy

from ...convergence.records import Run, store
from ...convergence.run_texts import names_of, run_lines, target_line
from ...core.settings.settings import SETTINGS, keeps_halves
from ..heard import implies_error_estimate
from ..panel import LATER, EnginePanel, draw_lines, draw_why, split_layout
from .operators import (
    RAYBATCH_OT_convergence_clear,
    RAYBATCH_OT_convergence_copy,
    RAYBATCH_OT_convergence_hide,
    RAYBATCH_OT_convergence_keep,
    RAYBATCH_OT_convergence_plot,
    RAYBATCH_OT_convergence_save,
)
from .properties import chosen_target
from .shown import Shown, panel_icon, slot_icon

# Height of capital letters and longest edge of the plot in the panel, at scale 1 [pixels]
_PANEL_TEXT, _PANEL_EDGE_MAX = 6.0, 640
_UNIT = 20  # pixels of Blender's icons at scale 1


class RAYBATCH_RENDER_PT_convergence(EnginePanel, bpy.types.Panel):
    """Error and rays a second over time, of the running render and of the last ones."""

    bl_label = "Convergence"
    bl_order = LATER
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        Shown.seen = True
        scene, layout = context.scene, split_layout(self.layout)
        row = layout.row()
        is_recorded = keeps_halves(scene.raybatch)  # whatever is said here
        row.active = not is_recorded
        row.prop(scene.raybatch_convergence, "record")
        if is_recorded:
            ruling = implies_error_estimate(scene.raybatch) or "error_estimate"
            draw_why(layout, context, f"Implied by {SETTINGS[ruling].label}")
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
            icon = panel_icon(scene, context.region.as_pointer(), round(edge * scale), _PANEL_TEXT * scale)
            layout.template_icon(icon_value=icon, scale=edge / _UNIT)
        draw_lines(layout, context, run_lines(runs[0], chosen_target(scene)))
        _draw_slots(layout, context, runs, chosen_target(scene))
        row = layout.row(align=True)
        row.operator(RAYBATCH_OT_convergence_plot.bl_idname, text="Show Plot", icon="IMAGE_DATA")
        row.operator(RAYBATCH_OT_convergence_copy.bl_idname, text="", icon="COPYDOWN")
        row.operator(RAYBATCH_OT_convergence_save.bl_idname, text="", icon="FILE_TICK")
        row.operator(RAYBATCH_OT_convergence_clear.bl_idname, text="", icon="TRASH").run = 0


def _hint(scene: bpy.types.Scene) -> str:
    if keeps_halves(scene.raybatch):
        return "The next render is recorded, with its error"
    if scene.raybatch_convergence.record:
        return "Rays a second of the next render are recorded. For its error turn on Error Estimate in Sampling"
    return "Nothing is recorded: turn on Error Estimate in Sampling, or Record Renders for rays a second alone"


def _draw_slots(layout, context, runs: list[Run], target: float) -> None:
    """For each run its colour and buttons, its name below them, and when it reaches the target."""
    names = names_of(runs)
    column = layout.column(align=True)
    for run in runs:
        number, _, rest = names[run.number].partition(", ")
        row = column.row(align=True)
        row.label(text=number, icon_value=slot_icon(run.slot))
        for operator, icon, depress in (
            (RAYBATCH_OT_convergence_hide, "HIDE_OFF" if run.shown else "HIDE_ON", False),
            (RAYBATCH_OT_convergence_keep, "PINNED" if run.kept else "UNPINNED", run.kept),
            (RAYBATCH_OT_convergence_clear, "X", False),
        ):
            row.operator(operator.bl_idname, text="", icon=icon, depress=depress).run = run.number
        if rest:
            draw_lines(column, context, [rest], "BLANK1")
        if len(runs) > 1 and run.points and run is not runs[0]:
            draw_lines(column, context, [target_line(run, target)], "BLANK1")
