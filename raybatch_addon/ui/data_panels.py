"""Panels outside of the render tab, for what Blender's own panels do not show: passes, filter, ray visibility,
light.
"""

from __future__ import annotations

import bpy

from ..export.passes import (
    CATCHER_PROPERTY,
    COST_PASS_PROPERTIES,
    LIGHT_PASS_PROPERTIES,
    MATTE_PROPERTIES,
    PASS_PROPERTIES,
    VOLUME_PASS_PROPERTIES,
)
from .panel import EnginePanel

_GEOMETRY = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}


class RAYBATCH_VIEWLAYER_PT_passes(EnginePanel, bpy.types.Panel):
    """Passes that can be rendered."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column(heading="Include")
        for name in ("use_pass_combined", *PASS_PROPERTIES):
            column.prop(context.view_layer, name)
        column.prop(context.view_layer, "pass_alpha_threshold")
        column.prop(context.view_layer.raybatch, "use_pass_sample_count")
        if hasattr(context.view_layer, "cycles"):  # the property is Cycles' own
            column.prop(context.view_layer.cycles, "denoising_store_passes", text="Denoising Data")
        column = layout.column(heading="Light")
        for name in LIGHT_PASS_PROPERTIES:
            column.prop(context.view_layer, name)
        if hasattr(context.view_layer, "cycles"):  # as above
            for name in (*VOLUME_PASS_PROPERTIES, CATCHER_PROPERTY):
                column.prop(context.view_layer.cycles, name)
        column = layout.column(heading="Cryptomatte")
        for name in MATTE_PROPERTIES:
            column.prop(context.view_layer, name)
        column.prop(context.view_layer, "pass_cryptomatte_depth", text="Levels")
        column = layout.column(heading="Cost")
        for name in COST_PASS_PROPERTIES:
            column.prop(context.view_layer.raybatch, name)


class RAYBATCH_VIEWLAYER_PT_filter(EnginePanel, bpy.types.Panel):
    """Parts of the scene that the view layer shows."""

    bl_label = "Filter"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column(heading="Include")
        column.prop(context.view_layer, "use_sky", text="Environment")
        column.prop(context.view_layer, "use_solid", text="Surfaces")
        column.prop(context.view_layer, "use_strand", text="Hair")
        column.prop(context.view_layer, "use_volumes", text="Volumes")
        if hasattr(context.view_layer, "use_motion_blur"):
            column.prop(context.view_layer, "use_motion_blur", text="Motion Blur")
        layout.prop(context.view_layer, "material_override")


class RAYBATCH_OBJECT_PT_ray_visibility(EnginePanel, bpy.types.Panel):
    """Kinds of rays that see an object, and whether it catches shadows."""

    bl_label = "Ray Visibility"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.object is not None and context.object.type in _GEOMETRY | {"LIGHT"}

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        column = layout.column()
        for ray in ("camera", "diffuse", "glossy", "transmission"):
            column.prop(context.object, f"visible_{ray}", text=ray.title())
        if context.object.type != "LIGHT":  # a light has a switch of its own for its shadow
            column.prop(context.object, "visible_shadow", text="Shadow")
            column.prop(context.object, "is_shadow_catcher")


class RAYBATCH_LIGHT_PT_settings(EnginePanel, bpy.types.Panel):
    """Settings of a light that Blender's own panel leaves out."""

    bl_label = "RayBatch"
    bl_context = "data"
    bl_parent_id = "DATA_PT_EEVEE_light"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.light is not None

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        light = context.light
        layout.prop(light, "use_shadow", text="Cast Shadow")
        if light.type == "AREA":
            layout.prop(light, "spread")


_classes = (
    RAYBATCH_VIEWLAYER_PT_passes,
    RAYBATCH_VIEWLAYER_PT_filter,
    RAYBATCH_OBJECT_PT_ray_visibility,
    RAYBATCH_LIGHT_PT_settings,
)


def register() -> None:
    """Add the panels."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Remove the panels."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
