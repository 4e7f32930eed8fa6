"""The menus of presets, by Blender's own mechanism: each entry is a file, and users add theirs."""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..blender.denoise_library import why_not
from ..core.settings.presets import PRESETS, preset_settings
from ..core.settings.settings import SETTINGS
from ..export.settings import assign_setting
from .panel import is_engine, register_all, unregister_all

# The folder in which Blender finds `presets`
_HOME = str(Path(__file__).parents[1])
RENDER, BATCHING = "raybatch/render", "raybatch/batching"
# Settings of the computer, not of the picture
_LEFT_OUT = {"denoise_library"} | {info.name for info in SETTINGS.values() if info.group == "DEVICE"}


class RAYBATCH_OT_preset(bpy.types.Operator):
    """Set what a preset of RayBatch sets"""

    bl_idname = "raybatch.preset"
    bl_label = "RayBatch Preset"
    bl_options = {"REGISTER", "UNDO"}

    preset: bpy.props.EnumProperty(
        name="Preset", items=[(name, preset.label, preset.description) for name, preset in PRESETS.items()]
    )

    @classmethod
    def poll(cls, context):
        return is_engine(context)

    @classmethod
    def description(cls, _context, properties):
        return PRESETS[properties.preset].description

    def execute(self, context):
        own = context.scene.raybatch
        values = preset_settings(self.preset)
        if values.get("denoise") == "ON" and (missing := why_not(own.denoise_library)):
            values["denoise"] = "OFF"
            self.report({"WARNING"}, f"RayBatch: not denoised: {missing}")
        for name, value in values.items():
            assign_setting(own, name, value)
        return {"FINISHED"}


def _preset_panel(label: str, folder: str, add: str) -> type:
    return type(
        f"RAYBATCH_PT_{folder.rpartition('/')[2]}_presets",
        (PresetPanel, bpy.types.Panel),
        {
            "__doc__": f"{label}.",
            "bl_label": label,
            "preset_subdir": folder,
            "preset_operator": "script.execute_preset",
            "preset_add_operator": add,
        },
    )


RAYBATCH_PT_render_presets = _preset_panel("Render Presets", RENDER, "raybatch.render_preset_add")
RAYBATCH_PT_batching_presets = _preset_panel("Batching Presets", BATCHING, "raybatch.batching_preset_add")


class _AddPreset(AddPresetBase):
    preset_defines = ["raybatch = bpy.context.scene.raybatch"]


class RAYBATCH_OT_render_preset_add(_AddPreset, bpy.types.Operator):
    """Add a preset of all settings but those of the device, or remove it"""

    bl_idname = "raybatch.render_preset_add"
    bl_label = "Add Render Preset"
    preset_menu = RAYBATCH_PT_render_presets.__name__
    preset_subdir = RENDER
    preset_values = [f"raybatch.{name}" for name in SETTINGS if name not in _LEFT_OUT]


class RAYBATCH_OT_batching_preset_add(_AddPreset, bpy.types.Operator):
    """Add a preset of the settings that change the time a render takes, and not its picture, or remove it"""

    bl_idname = "raybatch.batching_preset_add"
    bl_label = "Add Batching Preset"
    preset_menu = RAYBATCH_PT_batching_presets.__name__
    preset_subdir = BATCHING
    preset_values = [
        f"raybatch.{info.name}"
        for info in SETTINGS.values()
        if info.effect == "schedule" and info.name not in _LEFT_OUT
    ]


_classes = (
    RAYBATCH_OT_preset,
    RAYBATCH_PT_render_presets,
    RAYBATCH_PT_batching_presets,
    RAYBATCH_OT_render_preset_add,
    RAYBATCH_OT_batching_preset_add,
)


def register() -> None:
    """Add operators and menus, and have Blender find the files."""
    register_all(_classes)
    bpy.utils.register_preset_path(_HOME)


def unregister() -> None:
    """Remove the presets."""
    bpy.utils.unregister_preset_path(_HOME)
    unregister_all(_classes)
