"""Panels of view layers and objects, for what Blender's own panels do not show: passes, filter, ray visibility."""

from __future__ import annotations

import bpy

from ...export.passes import (
    CATCHER_PROPERTY,
    COST_PASS_PROPERTIES,
    LIGHT_PASS_PROPERTIES,
    MATTE_PROPERTIES,
    PASS_PROPERTIES,
    VOLUME_PASS_PROPERTIES,
)
from ..panel import EnginePanel, register_all, split_layout, unregister_all

_GEOMETRY = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}


# Passes of light that belong to no kind of reflection, with names that fit
_OTHER_LIGHT = {"use_pass_emit": "Emission", "use_pass_environment": "Environment", "use_pass_ambient_occlusion": "AO"}


def _light_passes() -> list[tuple[str, dict[str, str]]]:
    """The passes of each kind of reflection: its heading, and what each property is called below it."""
    found: dict[str, dict[str, str]] = {}
    for name, about in LIGHT_PASS_PROPERTIES.items():
        kind, _, part = about.partition(" ")
        if name not in _OTHER_LIGHT:
            found.setdefault(kind, {})[name] = part
    return list(found.items())


class RAYBATCH_VIEWLAYER_PT_passes(EnginePanel, bpy.types.Panel):
    """Passes that can be rendered."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        layout = split_layout(self.layout)
        layer = context.view_layer
        # properties of Cycles' own are there as long as that add-on is enabled
        of_cycles = getattr(layer, "cycles", None)
        column = layout.column(heading="Include")
        for name in ("use_pass_combined", *PASS_PROPERTIES):
            if name == "use_pass_z":
                column.prop(layer, name, text="Depth")  # as Blender 5 calls it
            else:
                column.prop(layer, name)
        column.prop(layer.raybatch, "use_pass_sample_count")
        if of_cycles is not None:
            column.prop(of_cycles, "denoising_store_passes", text="Denoising Data")
        layout.prop(layer, "pass_alpha_threshold", text="Alpha From")
        for heading, names in _light_passes():
            column = layout.column(heading=heading)
            for name, text in names.items():
                column.prop(layer, name, text=text)
        if of_cycles is not None:
            column = layout.column(heading="Volume")
            for name, about in VOLUME_PASS_PROPERTIES.items():
                column.prop(of_cycles, name, text=about.removeprefix("Volume "))
        column = layout.column(heading="Other")
        for name, text in _OTHER_LIGHT.items():
            column.prop(layer, name, text=text)
        world = context.scene.world
        if layer.use_pass_ambient_occlusion and world is not None:
            column.prop(world.light_settings, "distance", text="AO Distance")
        if of_cycles is not None:
            column.prop(of_cycles, CATCHER_PROPERTY)
        column = layout.column(heading="Cryptomatte")
        for name, kind in MATTE_PROPERTIES.items():
            column.prop(layer, name, text=kind.removeprefix("Crypto"))
        layout.prop(layer, "pass_cryptomatte_depth", text="Levels")
        column = layout.column(heading="Cost")
        for name in COST_PASS_PROPERTIES:
            column.prop(layer.raybatch, name)


class RAYBATCH_VIEWLAYER_PT_filter(EnginePanel, bpy.types.Panel):
    """Parts of the scene that the view layer shows."""

    bl_label = "Filter"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout = split_layout(self.layout)
        column = layout.column(heading="Include")
        column.prop(context.view_layer, "use_sky", text="Environment")
        column.prop(context.view_layer, "use_solid", text="Surfaces")
        column.prop(context.view_layer, "use_strand", text="Hair")
        column.prop(context.view_layer, "use_volumes", text="Volumes")
        if hasattr(context.view_layer, "use_motion_blur"):
            column.prop(context.view_layer, "use_motion_blur", text="Motion Blur")
        layout.prop(context.view_layer, "material_override", text="Material")
        if hasattr(context.view_layer, "world_override"):  # since Blender 5
            layout.prop(context.view_layer, "world_override", text="World")


class RAYBATCH_OBJECT_PT_ray_visibility(EnginePanel, bpy.types.Panel):
    """Kinds of rays that see an object, and whether it catches shadows."""

    bl_label = "Ray Visibility"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.object is not None and context.object.type in _GEOMETRY | {"LIGHT"}

    def draw(self, context):
        layout = split_layout(self.layout)
        column = layout.column()
        for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
            column.prop(context.object, f"visible_{ray}", text=ray.replace("_", " ").title())
        if context.object.type != "LIGHT":  # a light has a switch of its own for its shadow
            column.prop(context.object, "visible_shadow", text="Shadow")
            column.prop(context.object, "is_shadow_catcher")


_classes = (RAYBATCH_VIEWLAYER_PT_passes, RAYBATCH_VIEWLAYER_PT_filter, RAYBATCH_OBJECT_PT_ray_visibility)


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
