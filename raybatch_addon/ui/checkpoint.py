"""The checkpoint of final renders, at `scene.raybatch_checkpoint`, and its panel."""

from __future__ import annotations

import bpy

from ..blender.checkpoints import checkpoint_path
from .panel import EnginePanel, draw_lines, register_all, split_layout, unregister_all


class RayBatchCheckpoint(bpy.types.PropertyGroup):
    """Whether and how often a final render is kept in a file while it goes on."""

    use: bpy.props.BoolProperty(
        name="Checkpoint",
        description="Keep a final render in a file beside its output. A render that was stopped or crashed goes on "
        "from there when it is started again, and a finished one when it is started with more samples",
        default=False,
        options=set(),
    )
    interval: bpy.props.FloatProperty(
        name="Interval",
        description="Time from one copy to the next: what a crash loses at most. It is longer where copies would take "
        "more than a twentieth of the time",
        default=60.0,
        min=1.0,
        soft_max=3600.0,
        step=1000,
        precision=0,
        unit="TIME_ABSOLUTE",
        options=set(),
    )


class RAYBATCH_RENDER_PT_checkpoint(EnginePanel, bpy.types.Panel):
    """Keep a final render in a file, to go on from there."""

    bl_label = "Checkpoint"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.raybatch_checkpoint, "use", text="")

    def draw(self, context):
        layout, scene = split_layout(self.layout), context.scene
        own = scene.raybatch_checkpoint
        layout.active = own.use
        layout.prop(own, "interval")
        path = checkpoint_path(scene, context.view_layer.name)
        found = "The next render goes on from there, if nothing but its samples has changed"
        draw_lines(layout, context, [f"Kept as {path.name} in {path.parent}", *([found] if path.is_file() else [])])


_classes = (RayBatchCheckpoint, RAYBATCH_RENDER_PT_checkpoint)


def register() -> None:
    """Add `scene.raybatch_checkpoint` and the panel."""
    register_all(_classes)
    bpy.types.Scene.raybatch_checkpoint = bpy.props.PointerProperty(
        type=RayBatchCheckpoint, name="RayBatch Checkpoint", description="Checkpoints of final renders"
    )


def unregister() -> None:
    """Remove both."""
    del bpy.types.Scene.raybatch_checkpoint
    unregister_all(_classes)
