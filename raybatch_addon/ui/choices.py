"""Choices of the last render, for settings that let RayBatch choose: shown beside them, and kept by a click."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import reports
from ..core.errors import SettingsError
from ..core.settings.settings import BYTES, SettingInfo, parse_setting
from ..export.settings import assign_setting


def last_statistics(context) -> dict[str, Any] | None:
    """Statistics of the context's view layer, or of the first one there is, if the last render was of the context's
    scene.
    """
    report = reports.last()
    if report is None or report.scene != context.scene.name or not report.statistics:
        return None
    return report.statistics.get(context.view_layer.name) or next(iter(report.statistics.values()))


def last_choice(context, info: SettingInfo) -> dict[str, Any] | None:
    """`{"value": ..., "why": ...}` of the last render; None where the setting leaves no choice now, or nothing is
    known.
    """
    value = getattr(context.scene.raybatch, info.name)
    if not info.is_auto(_number(value) if info.unit == BYTES else value):
        return None
    statistics = last_statistics(context)
    return statistics.get("auto", {}).get(info.name) if statistics else None


def _number(text: str) -> int | None:
    return int(text) if text.isdecimal() else None


def value_text(info: SettingInfo, value: Any) -> str:
    """A value as the panel shows it."""
    for identifier, label, _ in info.choices:
        if identifier == value:
            return label
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (
            f"{value / 1e6:,.3g} MB"
            if info.unit == BYTES and value < 1e8
            else f"{value / 1e6:,.0f} MB"
            if info.unit == BYTES
            else f"{value:,}"
        )
    return str(value)


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


def draw_choice(row, context, info: SettingInfo) -> None:
    """Show in `row` what was chosen for a setting, if that is known."""
    choice = last_choice(context, info)
    if choice is None:
        return
    button = row.operator(RAYBATCH_OT_keep_choice.bl_idname, text=value_text(info, choice["value"]), emboss=False)
    button.setting, button.value, button.why = info.name, str(choice["value"]), str(choice["why"])


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(RAYBATCH_OT_keep_choice)


def unregister() -> None:
    """Remove the operator."""
    bpy.utils.unregister_class(RAYBATCH_OT_keep_choice)
