"""The panel Cluster: buttons, how far a render is, and how it ended."""

from __future__ import annotations

import bpy

from ...blender.cluster.command import CommandError
from ..panel import LATER, EnginePanel, draw_box, draw_lines
from . import running
from .operators import RAYBATCH_OT_render_on_cluster, RAYBATCH_OT_stop_on_cluster, named_environment


class RAYBATCH_RENDER_PT_cluster(EnginePanel, bpy.types.Panel):
    """Render on other computers, while Blender stays free."""

    bl_label = "Cluster"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = LATER

    def draw(self, context):
        layout = self.layout
        if (process := running.process_running()) is not None:
            text = "Stopping" if process.is_stopped else process.message
            draw_lines(layout, context, [f"{round(100 * process.fraction)} %", text], "TIME")
            layout.operator(RAYBATCH_OT_stop_on_cluster.bl_idname, icon="CANCEL")
            return
        try:
            environment = named_environment()
            environment.command()
            environment.where()
        except CommandError as error:
            draw_box(layout, context, f"{str(error)[:1].upper()}{str(error)[1:]}")
        column = layout.column(align=True)
        column.operator(RAYBATCH_OT_render_on_cluster.bl_idname, icon="RENDER_STILL").animation = False
        text = "Render Animation on Cluster"
        column.operator(RAYBATCH_OT_render_on_cluster.bl_idname, text=text, icon="RENDER_ANIMATION").animation = True
        if running.current is not None:
            _draw_last(layout, context, running.current)


def _draw_last(layout, context, job: running.ClusterJob) -> None:
    process = job.process
    if job.error:
        draw_box(layout, context, job.error, "ERROR", alert=True)
    count = len(process.saved)
    if count:
        files = f"{count} file{'s' if count != 1 else ''} of “{job.scene}”, the last one as the image “{running.IMAGE}”"
        draw_lines(layout, context, [files], "CHECKMARK")
    if process.is_stopped:
        draw_lines(layout, context, ["It was stopped"], "CANCEL")
    draw_lines(layout, context, process.warnings[:5])


def register() -> None:
    """Add the panel."""
    bpy.utils.register_class(RAYBATCH_RENDER_PT_cluster)


def unregister() -> None:
    """Remove the panel."""
    bpy.utils.unregister_class(RAYBATCH_RENDER_PT_cluster)
