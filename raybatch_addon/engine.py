"""Blender's door to RayBatch: each call is passed on in one line."""

from __future__ import annotations

import bpy

from .blender import warm_up
from .blender.result import register_passes


class RayBatchRenderEngine(bpy.types.RenderEngine):
    """Final renders. The viewport's Rendered mode is not offered: without `view_draw` Blender hides it."""

    bl_idname = "RAYBATCH"
    bl_label = "RayBatch"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # Material Preview
    bl_use_shading_nodes_custom = False  # Blender's own shader nodes: otherwise their editor hides

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.report_of_frame = None  # Blender makes an engine for each frame: nothing else is kept here

    def update_render_passes(self, scene=None, renderlayer=None):
        register_passes(self, scene, renderlayer)

    def render(self, depsgraph):
        warm_up.finish_warm_up()
        from .blender.frame import render_view_layer  # brings in Warp, which opening Blender should not wait for

        render_view_layer(self, depsgraph)
