"""Settings of viewports, at `scene.raybatch_viewport`, and their panel."""

from __future__ import annotations

import bpy

from ..blender.denoise_library import why_not
from ..core.errors import SettingsError
from ..export.live.settings import SAMPLES_DEFAULT, left_out
from .panel import EnginePanel, draw_box, register_all, split_layout, unregister_all


class RayBatchViewport(bpy.types.PropertyGroup):
    """RayBatch's settings of the Rendered mode of the 3D view."""

    samples: bpy.props.IntProperty(
        name="Samples",
        description="Paths traced through every pixel of the 3D view, which rests when it has them",
        default=SAMPLES_DEFAULT,
        min=1,
        soft_max=4096,
        options=set(),
    )
    denoise: bpy.props.BoolProperty(
        name="Denoise",
        description="Show pictures without their noise, at 1, 2, 4, 8 and so on samples. How is set under Denoise",
        default=False,
        options=set(),
    )


class RAYBATCH_RENDER_PT_viewport(EnginePanel, bpy.types.Panel):
    """Settings of the Rendered mode of the 3D view."""

    bl_label = "Viewport"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, scene = split_layout(self.layout), context.scene
        own = scene.raybatch_viewport
        layout.prop(own, "samples")
        missing = why_not(scene.raybatch.denoise_library)
        row = layout.row()
        row.enabled = own.denoise or not missing
        row.prop(own, "denoise")
        if missing:
            draw_box(layout, context, missing)
        layout.prop(scene.render, "preview_pixel_size", text="Pixel Size")
        try:
            names = left_out(scene)
        except SettingsError:  # the panel of what is wrong shows it
            return
        if names:
            draw_box(layout, context, f"Final renders alone have: {', '.join(names)}")


_classes = (RayBatchViewport, RAYBATCH_RENDER_PT_viewport)


def register() -> None:
    """Add `scene.raybatch_viewport` and the panel."""
    register_all(_classes)
    bpy.types.Scene.raybatch_viewport = bpy.props.PointerProperty(
        type=RayBatchViewport, name="RayBatch Viewport", description="RayBatch's settings of the 3D view"
    )


def unregister() -> None:
    """Remove both."""
    del bpy.types.Scene.raybatch_viewport
    unregister_all(_classes)
