"""Panels of light groups: those of a view layer, and the group that an object or a world is in."""

from __future__ import annotations

import bpy

from ..panel import EnginePanel, WorldPanel, register_all, unregister_all


class RAYBATCH_VIEWLAYER_PT_light_groups(EnginePanel, bpy.types.Panel):
    """The groups of emitters that have passes of their own."""

    bl_label = "Light Groups"
    bl_context = "view_layer"
    bl_parent_id = "RAYBATCH_VIEWLAYER_PT_passes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layer = context.view_layer
        row = self.layout.row()
        row.template_list("UI_UL_list", "lightgroups", layer, "lightgroups", layer, "active_lightgroup_index", rows=3)
        buttons = row.column(align=True)
        buttons.operator("scene.view_layer_add_lightgroup", icon="ADD", text="")
        buttons.operator("scene.view_layer_remove_lightgroup", icon="REMOVE", text="")
        buttons.separator()
        buttons.menu("VIEWLAYER_MT_lightgroup_sync", icon="DOWNARROW_HLT", text="")


def _draw_group(layout: bpy.types.UILayout, owner: bpy.types.ID, layer: bpy.types.ViewLayer) -> None:
    layout.use_property_split = True
    row = layout.row(align=True)
    row.use_property_decorate = False
    row.prop_search(owner, "lightgroup", layer, "lightgroups", text="Light Group", results_are_suggestions=True)
    new = row.column(align=True)
    new.enabled = bool(owner.lightgroup) and owner.lightgroup not in layer.lightgroups
    new.operator("scene.view_layer_add_lightgroup", icon="ADD", text="").name = owner.lightgroup


class RAYBATCH_OBJECT_PT_light_group(EnginePanel, bpy.types.Panel):
    """The group of an object's light."""

    bl_label = "Light Group"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_shading"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.object is not None

    def draw(self, context):
        _draw_group(self.layout, context.object, context.view_layer)


class RAYBATCH_WORLD_PT_light_group(WorldPanel, bpy.types.Panel):
    """The group of the world's light."""

    bl_label = "Light Group"

    def draw(self, context):
        _draw_group(self.layout, context.world, context.view_layer)


_classes = (RAYBATCH_VIEWLAYER_PT_light_groups, RAYBATCH_OBJECT_PT_light_group, RAYBATCH_WORLD_PT_light_group)


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
