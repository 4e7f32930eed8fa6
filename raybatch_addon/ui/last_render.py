"""What the last render said: errors, warnings and how long it took."""

from __future__ import annotations

import textwrap

import bpy

from .. import reports
from .panel import EnginePanel

# Mean width of a letter of Blender's interface [pixels at scale 1], for breaking lines
_LETTER_WIDTH = 6.5


class RAYBATCH_RENDER_PT_last_render(EnginePanel, bpy.types.Panel):
    """Errors and warnings of the last render."""

    bl_label = "Last Render"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and reports.last() is not None

    def draw_header(self, _context):
        report = reports.last()
        if report.errors or report.warnings:
            self.layout.label(text="", icon="ERROR" if report.errors else "INFO")

    def draw(self, context):
        report = reports.last()
        scale = context.preferences.system.ui_scale
        letters = max(20, int(context.region.width / (_LETTER_WIDTH * scale)))
        column = self.layout.column(align=True)
        column.label(text=f"{report.scene}, frame {report.frame}")
        for line in report_lines(report):
            column.label(text=line)
        for icon, texts in (("ERROR", report.errors), ("INFO", report.warnings)):
            for text in texts:
                box = self.layout.box().column(align=True)
                for i, line in enumerate(textwrap.wrap(text, letters) or [""]):
                    box.label(text=line, icon=icon if i == 0 else "BLANK1")
        if not report.errors and not report.warnings:
            self.layout.label(text="No warnings", icon="CHECKMARK")


def report_lines(report: reports.RenderReport) -> list[str]:
    """One line a view layer: device, seconds, rays a second, samples that had to be repaired."""
    lines = []
    for name, statistics in report.statistics.items():
        seconds = statistics["seconds"]
        rays = statistics["rays"]["total"] / seconds["render"] / 1e6 if seconds.get("render") else 0.0
        lines.append(f"{name}: {seconds['total']:.2f} s on {statistics['device']['alias']}, {rays:.2f} Mrays/s")
        if statistics["invalid_samples"]:
            lines.append(f"{name}: {statistics['invalid_samples']:,} samples were not finite and count as black")
    return lines


@bpy.app.handlers.persistent
def _show_at_end(*_) -> None:
    # the end of a render alone does not make Blender draw the Properties editor again
    for manager in bpy.data.window_managers:
        for window in manager.windows:
            for area in window.screen.areas:
                if area.type == "PROPERTIES":
                    area.tag_redraw()


def register() -> None:
    """Add the panel."""
    bpy.utils.register_class(RAYBATCH_RENDER_PT_last_render)
    for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
        handlers.append(_show_at_end)


def unregister() -> None:
    """Remove the panel."""
    for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
        handlers.remove(_show_at_end)
    bpy.utils.unregister_class(RAYBATCH_RENDER_PT_last_render)
