"""Blender's door to RayBatch: each call is passed on in one line."""

from __future__ import annotations

import bpy

from .blender import warm_up
from .blender.result import register_passes
from .blender.viewport import callbacks


class RayBatchRenderEngine(bpy.types.RenderEngine):
    """Final renders, previews, and the Rendered mode of the 3D view."""

    bl_idname = "RAYBATCH"
    bl_label = "RayBatch"
    bl_use_preview = True
    bl_use_eevee_viewport = True  # Material Preview
    bl_use_shading_nodes_custom = False  # Blender's own shader nodes: otherwise their editor hides

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        # Blender makes an engine for each frame and each region of the 3D view: nothing else is kept here
        self.report_of_frame = self.viewport = None

    def update_render_passes(self, scene=None, renderlayer=None):
        register_passes(self, scene, renderlayer)

    def render(self, depsgraph):
        warm_up.finish_warm_up()
        if self.is_preview:
            from .blender.preview import render_preview

            render_preview(self, depsgraph)
            return
        from .blender.frame import render_view_layer  # brings in Warp, which opening Blender should not wait for

        render_view_layer(self, depsgraph)

    def view_update(self, context, depsgraph):
        callbacks.view_update(self, context, depsgraph)

    def view_draw(self, context, depsgraph):
        callbacks.view_draw(self, context, depsgraph)
