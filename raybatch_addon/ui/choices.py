"""Choices of the last render, for settings that let RayBatch choose: shown beside them, and kept by a click."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import reports
from ..core.errors import SettingsError
from ..core.settings.settings import BYTES, SettingInfo, parse_setting
from ..export.settings import assign_setting
from .panel import VALUE_SHARE, label_width, value_width

# What a button that shows a choice keeps free beside its text [pixels]
_CHOICE_MARGIN = 12
# The share of a dropdown beside it
_DROPDOWN_SHARE_LEAST, _DROPDOWN_SHARE_MOST = 0.4, 0.8


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
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return info.name_of(value)
    if info.unit == BYTES:
        return _bytes_text(value)
    return f"{value:,} px" if info.unit == "pixels" else f"{value:,}"


def _bytes_text(count: float) -> str:
    """A number of bytes in three digits, with the unit for it."""
    if count >= 999.5e9:
        return f"{count / 1e12:,.4g} TB"
    for size, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= 0.9995 * size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.3g} bytes"


def short_text(info: SettingInfo, value: Any) -> str:
    """The same where there is little room: large numbers in three digits."""
    if info.unit != BYTES and isinstance(value, int) and value >= 1_000_000:
        return f"{value / 1e6:.3g} M"
    return value_text(info, value)


class RAYBATCH_OT_keep_choice(bpy.types.Operator):
    """Keep what RayBatch chose in the last render"""

    bl_idname = "raybatch.keep_choice"
    bl_label = "Keep RayBatch's Choice"
    bl_options = {"UNDO", "INTERNAL"}

    setting: bpy.props.StringProperty(name="Setting")
    value: bpy.props.StringProperty(name="Value")
    shown: bpy.props.StringProperty(name="Shown")
    why: bpy.props.StringProperty(name="Why")

    @classmethod
    def description(cls, _context, properties):
        return f"Chosen in the last render: {properties.shown}, {properties.why}.\nClick to keep it"

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
    return "Auto" if choice is None else f"Auto, {short_text(info, choice['value'])}"


def choice_width(text: str) -> float:
    """Of the button that shows a dropdown's choice, at scale 1 [pixels]."""
    return label_width(text) + _CHOICE_MARGIN


def draw_dropdown(column, context, info: SettingInfo) -> None:
    """A dropdown, and where it lets RayBatch choose what was chosen, with as much room as that needs."""
    own, choice = context.scene.raybatch, last_choice(context, info)
    if choice is None:
        column.prop(own, info.name)
        return
    shown = value_text(info, choice["value"])
    share = 1 - choice_width(shown) / value_width(context)
    # Blender gives names and values their places only where a row holds one of each
    split = column.split(factor=1 - VALUE_SHARE)
    split.use_property_split = False
    name = split.row()
    name.alignment = "RIGHT"
    name.label(text=info.label)
    split = split.split(factor=min(max(share, _DROPDOWN_SHARE_LEAST), _DROPDOWN_SHARE_MOST), align=True)
    split.prop(own, info.name, text="")
    _draw_button(split, info, choice, text=shown)


def draw_choice(row, context, info: SettingInfo) -> None:
    """A button that keeps the number that was chosen for a setting, if that is known."""
    choice = last_choice(context, info)
    if choice is not None:
        _draw_button(row, info, choice, icon="UNPINNED")


def _draw_button(layout, info: SettingInfo, choice: dict[str, Any], text: str = "", icon: str = "NONE") -> None:
    button = layout.operator(RAYBATCH_OT_keep_choice.bl_idname, text=text, icon=icon, emboss=False)
    button.setting, button.value = info.name, str(choice["value"])
    button.shown, button.why = value_text(info, choice["value"]), str(choice["why"])


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(RAYBATCH_OT_keep_choice)


def unregister() -> None:
    """Remove the operator."""
    bpy.utils.unregister_class(RAYBATCH_OT_keep_choice)
