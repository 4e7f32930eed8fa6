"""Operators: look at the scene, show where something is missing, take over settings of another engine."""

from __future__ import annotations

import bpy

from ...blender import missing
from ..panel import is_engine, register_all, unregister_all
from .unhidden import unhidden


class _OfEngine:
    @classmethod
    def poll(cls, context):
        return is_engine(context)


class RAYBATCH_OT_check_scene(_OfEngine, bpy.types.Operator):
    """Read the scene as a render does, and list what it would lack"""

    bl_idname = "raybatch.check_scene"
    bl_label = "Check Scene"

    def execute(self, context):
        from ...core.errors import RayBatchError
        from ...export.passed_over.look import with_light_looked_for
        from ...export.scene import export_scene
        from ...export.view import View

        try:
            with unhidden(context.view_layer):
                look = export_scene(context.evaluated_depsgraph_get(), view=View(is_look=True))
            assert look is not None  # nobody cancels it
            exported = with_light_looked_for(look)
        except RayBatchError as error:
            self.report({"ERROR"}, f"RayBatch: {error}")
            return {"CANCELLED"}
        missing.begin_look(context.scene)
        found = missing.keep_found(context.scene, context.view_layer.name, exported.warnings)
        missing.print_notices(found)
        count = f"{len(found)} message{'s' if len(found) != 1 else ''} in the panel Before the Render"
        self.report({"INFO"}, f"RayBatch: {count}" if found else "RayBatch: nothing is missing")
        return {"FINISHED"}


class RAYBATCH_OT_select_object(_OfEngine, bpy.types.Operator):
    """Select the objects that this is about, and make the first the active one"""

    bl_idname = "raybatch.select_object"
    bl_label = "Select"
    bl_options = {"REGISTER", "UNDO"}

    number: bpy.props.IntProperty(name="Number", description="Place in the list", min=0)

    def execute(self, context):
        found = missing.found_in(context.scene) or []
        if self.number >= len(found):
            return {"CANCELLED"}
        notice = found[self.number]
        there = [context.view_layer.objects.get(name) for name in notice.objects]
        there = [obj for obj in there if obj is not None]
        if not there:
            self.report({"WARNING"}, "RayBatch: these objects are not in this view layer")
            return {"CANCELLED"}
        for obj in context.view_layer.objects:
            obj.select_set(obj in there)
        context.view_layer.objects.active = there[0]
        _show_node(there[0], notice)
        return {"FINISHED"}


def _show_node(obj: bpy.types.Object, notice) -> None:
    """Make the material of `notice` the object's active one, and its first node the tree's."""
    for index, slot in enumerate(obj.material_slots):
        if slot.material is None or slot.material.name != notice.material:
            continue
        obj.active_material_index = index
        tree = slot.material.node_tree
        node = tree.nodes.get(notice.nodes[0]) if tree is not None and notice.nodes else None
        if node is not None:
            tree.nodes.active = node


class RAYBATCH_OT_settings_from(_OfEngine, bpy.types.Operator):
    """Give samples, bounces, clamping, filter and what else both have the values of another engine"""

    bl_idname = "raybatch.settings_from"
    bl_label = "Settings From"
    bl_options = {"REGISTER", "UNDO"}

    engine: bpy.props.EnumProperty(
        name="Engine",
        items=[
            ("CYCLES", "Cycles", "The settings of Cycles of this scene"),
            ("EEVEE", "EEVEE", "The settings of EEVEE of this scene, and the materials' outputs for it"),
        ],
    )

    def execute(self, context):
        from ...core.errors import SettingsError
        from ...export.taken_over.take import take_over

        try:
            changed = take_over(context.scene, self.engine)
        except SettingsError as error:
            self.report({"ERROR"}, f"RayBatch: {error}")
            return {"CANCELLED"}
        for each in changed:
            self.report({"INFO"}, each.taken(self.engine))
        if not changed:
            self.report({"INFO"}, "RayBatch: the settings are those already")
        return {"FINISHED"}


_classes = (RAYBATCH_OT_check_scene, RAYBATCH_OT_select_object, RAYBATCH_OT_settings_from)


def register() -> None:
    """Add the operators."""
    bpy.app.handlers.load_pre.append(missing.forget_found)
    register_all(_classes)


def unregister() -> None:
    """Remove the operators."""
    bpy.app.handlers.load_pre.remove(missing.forget_found)
    unregister_all(_classes)
