"""The menu of presets in the panel Performance."""

from __future__ import annotations

import bpy

from ..core.settings.presets import PRESETS, preset_settings
from ..export.settings import assign_setting
from .panel import ENGINE


class RAYBATCH_OT_schedule_preset(bpy.types.Operator):
    """Set all settings of Performance at once. The picture stays the same"""

    bl_idname = "raybatch.schedule_preset"
    bl_label = "RayBatch Preset"
    bl_options = {"REGISTER", "UNDO"}

    preset: bpy.props.EnumProperty(
        name="Preset", items=[(name, preset.label, preset.description) for name, preset in PRESETS.items()]
    )

    @classmethod
    def poll(cls, context):
        return context.scene is not None and context.engine == ENGINE

    @classmethod
    def description(cls, _context, properties):
        return f"{PRESETS[properties.preset].description}. Sets all settings of Performance; the picture stays the same"

    def execute(self, context):
        for name, value in preset_settings(self.preset).items():
            assign_setting(context.scene.raybatch, name, value)
        return {"FINISHED"}


class RAYBATCH_MT_schedule_presets(bpy.types.Menu):
    """Presets of all settings of Performance"""

    bl_label = "Presets"

    def draw(self, _context):
        for name, preset in PRESETS.items():
            self.layout.operator(RAYBATCH_OT_schedule_preset.bl_idname, text=preset.label).preset = name


_classes = (RAYBATCH_OT_schedule_preset, RAYBATCH_MT_schedule_presets)


def register() -> None:
    """Add operator and menu."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Remove the presets."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
