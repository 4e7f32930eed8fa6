"""Choices of the last render, for settings that let RayBatch choose: shown beside them, and kept by a click."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import reports
from ..core.errors import SettingsError
from ..core.settings.settings import BYTES, SettingInfo, parse_setting
from ..export.settings import assign_setting


def statistics_of(scene: bpy.types.Scene, layer_name: str = "") -> dict[str, Any] | None:
    """Statistics of the view layer, or of the first one there is, if the last render was of `scene`."""
    report = reports.last()
    if report is None or report.scene != scene.name or not report.statistics:
        return None
    return report.statistics.get(layer_name) or next(iter(report.statistics.values()))


def last_statistics(context) -> dict[str, Any] | None:
    """Statistics of the context's scene and view layer."""
    return statistics_of(context.scene, context.view_layer.name)


def chosen_for(statistics: dict[str, Any] | None, name: str) -> dict[str, Any] | None:
    """`{"value": ..., "why": ...}` of the setting `name`; None where nothing is known."""
    return statistics.get("auto", {}).get(name) if statistics else None


def last_choice(context, info: SettingInfo) -> dict[str, Any] | None:
    """What was chosen in the last render; None where the setting leaves no choice now, or nothing is known."""
    value = getattr(context.scene.raybatch, info.name)
    is_auto = info.is_auto(_number(value) if info.unit == BYTES else value)
    return chosen_for(last_statistics(context), info.name) if is_auto else None


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def value_text(info: SettingInfo, value: Any) -> str:
    """A value as the panel shows it."""
    for identifier, label, _ in info.choices:
        if identifier == value:
            return label
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return str(value)
    if info.unit == BYTES:
        return f"{value / 1e6:,.3g} MB" if value < 1e8 else f"{value / 1e6:,.0f} MB"
    return f"{value:,} px" if info.unit == "pixels" else f"{value:,}"


class RAYBATCH_OT_keep_choice(bpy.types.Operator):
    """Keep what RayBatch chose in the last render"""

    bl_idname = "raybatch.keep_choice"
    bl_label = "Keep RayBatch's Choice"
    bl_options = {"UNDO", "INTERNAL"}

    setting: bpy.props.StringProperty(name="Setting")
    value: bpy.props.StringProperty(name="Value")
    why: bpy.props.StringProperty(name="Why")

    @classmethod
    def description(cls, _context, properties):
        return f"Chosen in the last render: {properties.why}.\nClick to keep it"

    def execute(self, context):
        try:
            value = parse_setting(self.setting, self.value)
        except SettingsError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        assign_setting(context.scene.raybatch, self.setting, value)
        return {"FINISHED"}


def auto_text(context, info: SettingInfo) -> str:
    """What stands beside the checkbox of a setting that lets RayBatch choose: also what it chose, if that is known."""
    choice = last_choice(context, info)
    return "Auto" if choice is None else f"Auto, {value_text(info, choice['value'])}"


def draw_choice(row, context, info: SettingInfo) -> None:
    """A button that keeps what was chosen for a setting, if that is known; it shows the choice of a dropdown."""
    choice = last_choice(context, info)
    if choice is None:
        return
    text = value_text(info, choice["value"]) if info.choices else ""
    icon = "NONE" if info.choices else "UNPINNED"
    button = row.operator(RAYBATCH_OT_keep_choice.bl_idname, text=text, icon=icon, emboss=False)
    button.setting, button.value, button.why = info.name, str(choice["value"]), str(choice["why"])


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(RAYBATCH_OT_keep_choice)


def unregister() -> None:
    """Remove the operator."""
    bpy.utils.unregister_class(RAYBATCH_OT_keep_choice)
