"""Panels of materials, worlds, lights and objects for what Blender shows to its own engines alone, and passes of
materials.
"""

from __future__ import annotations

import bpy
from bl_ui.properties_view_layer import ViewLayerAOVPanelHelper
from bpy_extras.node_utils import find_node_input

from ...export.settings import output_engine
from ..panel import (
    EnginePanel,
    WorldPanel,
    choice_text,
    draw_below_name,
    draw_box,
    draw_lines,
    draw_why,
    register_all,
    split_layout,
    unregister_all,
)

_EMISSION_SAMPLING = ("NONE", "AUTO", "FRONT_BACK")  # of Cycles' choices those that are heard


class RAYBATCH_MATERIAL_PT_settings(EnginePanel, bpy.types.Panel):
    """Settings of a material beside its nodes."""

    bl_label = "Settings"
    bl_context = "material"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.material is not None and not context.material.grease_pencil

    def draw(self, context):
        layout = split_layout(self.layout)
        draw_below_name(layout, context.material, "displacement_method", "Displacement")
        row = layout.row()
        row.use_property_split = False  # its name is too long for a place beside names
        row.prop(context.material, "use_transparent_shadow")
        layout.prop(context.material, "pass_index")
        if hasattr(context.material, "cycles"):
            _draw_emission_sampling(layout, context, context.material.cycles)


def _draw_emission_sampling(layout, context, own) -> None:
    """A button for each choice that is heard, and a word on what a file of Cycles has beside these."""
    layout.label(text="Emission Sampling")
    column = layout.column(align=True)
    column.use_property_split = False
    for choice in _EMISSION_SAMPLING:
        column.prop_enum(own, "emission_sampling", choice)
    if own.emission_sampling not in _EMISSION_SAMPLING:
        chosen = choice_text(own, "emission_sampling")
        draw_box(layout, context, f"{chosen} alone is not heard: rays are aimed at both sides")


class _WorldPanel(WorldPanel):
    settings = ""  # the property of a world, of Cycles' add-on, that the panel shows

    @classmethod
    def poll(cls, context):
        return super().poll(context) and hasattr(context.world, cls.settings)


class RAYBATCH_WORLD_PT_ray_visibility(_WorldPanel, bpy.types.Panel):
    """Kinds of rays that see the world."""

    bl_label = "Ray Visibility"
    settings = "cycles_visibility"

    def draw(self, context):
        layout = split_layout(self.layout)
        column = layout.column()
        for ray in ("camera", "diffuse", "glossy", "transmission", "scatter"):
            column.prop(context.world.cycles_visibility, ray)


class RAYBATCH_WORLD_PT_settings(_WorldPanel, bpy.types.Panel):
    """How rays are aimed at a world's light."""

    bl_label = "Settings"
    settings = "cycles"

    def draw(self, context):
        layout = split_layout(self.layout)
        own = context.world.cycles
        layout.prop(own, "sampling_method", text="Sampling")
        unused = f"Unused with Sampling {choice_text(own, 'sampling_method')}"
        row = layout.row()
        row.active = own.sampling_method == "MANUAL"
        row.prop(own, "sample_map_resolution", text="Resolution")
        draw_why(layout, context, unused if own.sampling_method == "AUTOMATIC" else "")
        column = layout.column()
        column.active = own.sampling_method != "NONE"
        column.prop(own, "max_bounces")
        if hasattr(own, "use_shadows"):  # Blender 4.5 has it not
            column.prop(own, "use_shadows", text="Cast Shadow")
        draw_why(layout, context, unused if own.sampling_method == "NONE" else "")


class RAYBATCH_WORLD_PT_ambient_occlusion(WorldPanel, bpy.types.Panel):
    """How far ambient occlusion looks: the pass, and nodes without a distance of their own."""

    bl_label = "Ambient Occlusion"

    def draw(self, context):
        split_layout(self.layout).prop(context.world.light_settings, "distance")


class RAYBATCH_OBJECT_PT_shadow_terminator(EnginePanel, bpy.types.Panel):
    """Where shadow rays begin on a smooth mesh."""

    bl_label = "Shadow Terminator"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_shading"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.object is not None and context.object.type not in ("LIGHT", "CAMERA")

    def draw(self, context):
        # its name is too long for a place beside values
        self.layout.prop(context.object, "shadow_terminator_geometry_offset", text="Geometry Offset")


def _is_portal(light: bpy.types.Light) -> bool:
    return light.type == "AREA" and getattr(getattr(light, "cycles", None), "is_portal", False)


class RAYBATCH_LIGHT_PT_settings(EnginePanel, bpy.types.Panel):
    """Settings of a light that Blender's own panel leaves out."""

    bl_label = "Settings"
    bl_context = "data"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.light is not None

    def draw(self, context):
        layout = split_layout(self.layout)
        light = context.light
        column, is_portal = layout.column(), _is_portal(light)
        column.active = not is_portal
        if hasattr(light, "cycles"):
            column.prop(light.cycles, "max_bounces")
        column.prop(light, "use_shadow", text="Cast Shadow")
        if light.type != "AREA":
            return
        column.prop(light, "spread")
        draw_why(layout, context, "Unused with Portal on" if is_portal else "")
        if hasattr(light, "cycles"):
            layout.prop(light.cycles, "is_portal", text="Portal")


class RAYBATCH_LIGHT_PT_nodes(EnginePanel, bpy.types.Panel):
    """The nodes of a light."""

    bl_label = "Nodes"
    bl_context = "data"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.light is not None and not _is_portal(context.light)

    def draw(self, context):
        layout, light = split_layout(self.layout, animated=True), context.light
        if bpy.app.version < (5, 0):
            layout.prop(light, "use_nodes", icon="NODETREE")
            if not light.use_nodes:
                return
        tree = light.node_tree
        node = tree.get_output_node(output_engine(context.scene)) if tree is not None else None
        surface = find_node_input(node, "Surface") if node is not None else None
        if surface is None:
            draw_lines(layout, context, ["No nodes: its color is even" if tree is None else "No output node"])
        else:
            layout.template_node_view(tree, node, surface)


class RAYBATCH_VIEWLAYER_PT_aov(EnginePanel, bpy.types.Panel):
    """Passes that materials write."""

    bl_label = "Shader AOV"
    bl_context = "view_layer"
    bl_parent_id = "RAYBATCH_VIEWLAYER_PT_passes"
    bl_options = {"DEFAULT_CLOSED"}
    draw = ViewLayerAOVPanelHelper.draw


_classes = (
    RAYBATCH_MATERIAL_PT_settings,
    RAYBATCH_WORLD_PT_ray_visibility,
    RAYBATCH_WORLD_PT_settings,
    RAYBATCH_WORLD_PT_ambient_occlusion,
    RAYBATCH_OBJECT_PT_shadow_terminator,
    RAYBATCH_LIGHT_PT_settings,
    RAYBATCH_LIGHT_PT_nodes,
    RAYBATCH_VIEWLAYER_PT_aov,
)


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
