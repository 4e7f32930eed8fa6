"""The settings in the render tab: one panel a group of settings, made from the core's definitions."""

from __future__ import annotations

import bpy

from ..blender.denoise_library import why_not
from ..core.errors import SettingsError
from ..core.settings.info import GroupInfo
from ..core.settings.settings import BYTES, GROUPS, SETTINGS, SettingInfo, parse_setting
from ..export.settings import settings_from
from .choices import auto_text, draw_choice, draw_dropdown
from .devices import draw_devices
from .heard import why_unheard
from .memory import estimate_lines
from .panel import LATER, EnginePanel, draw_box, draw_lines, draw_why, register_all, split_layout, unregister_all
from .presets import RAYBATCH_PT_batching_presets, RAYBATCH_PT_render_presets
from .properties import megabytes_name, switch_name

# The setting whose checkbox stands in the header of its group's panel
_IN_HEADER = {"DENOISING": "denoise"}
_SCHEDULE = "BATCHING"
# The menus of presets in headers
_PRESETS: dict[str, type[bpy.types.Panel]] = {
    "SAMPLING": RAYBATCH_PT_render_presets,
    _SCHEDULE: RAYBATCH_PT_batching_presets,
}
_LATER = ("PERFORMANCE", "BATCHING")


def shown_name(info: SettingInfo) -> str:
    """The property that a panel shows for the value of a setting."""
    if info.is_switch:
        return switch_name(info)
    return megabytes_name(info) if info.unit == BYTES else info.name


def _draw(self, context):
    layout = split_layout(self.layout)
    own = context.scene.raybatch
    missing = why_not(own.denoise_library) if self.group == "DENOISING" else ""
    column = layout.column()
    if self.group == "FILM":
        column.prop(context.scene.raybatch_export, "exposure")
    why = ""
    for info in SETTINGS.values():
        if info.group != self.group or info.name == _IN_HEADER.get(self.group):
            continue
        above, why = why, "" if missing else why_unheard(own, info.name)
        if above != why:  # said once, below all that it holds for
            draw_why(column, context, above)
        part = column.column()
        part.active = not why
        part.enabled = not missing or info.name == "denoise_library"
        _draw_setting(part, context, info)
    draw_why(column, context, why)
    if missing:
        draw_box(layout, context, missing)
    if self.group == "FILM":
        column.prop(context.scene.render, "film_transparent", text="Transparent")
        if hasattr(context.scene, "cycles"):
            _draw_glass(column, context)
    elif self.group == "PERFORMANCE":
        column.prop(context.scene.render, "use_persistent_data", text="Persistent Data")
    elif self.group == _SCHEDULE:
        _draw_complaint(layout, context)
    elif self.group == "MEMORY":
        draw_lines(layout, context, estimate_lines(context))


def _draw_glass(column, context) -> None:
    """Whether a transparent film shows through glass; settings of Cycles."""
    scene, glass = context.scene, column.column()
    is_transparent = scene.render.film_transparent
    glass.active = is_transparent
    glass.prop(scene.cycles, "film_transparent_glass", text="Transparent Glass")
    if scene.cycles.film_transparent_glass:
        glass.prop(scene.cycles, "film_transparent_roughness", text="Roughness Threshold")
    draw_why(column, context, "" if is_transparent else "Unused with Transparent off")


def _draw_setting(column, context, info: SettingInfo) -> None:
    own = context.scene.raybatch
    if info.name == "device":
        draw_devices(column, context)
        return
    switch = "" if info.is_switch else switch_name(info)
    if not switch and info.auto is not None:
        draw_dropdown(column, context, info)
        return
    if not switch:
        column.prop(own, shown_name(info))
        return
    is_set = getattr(own, switch) == (info.auto is None)
    unit = " (MB)" if info.unit == BYTES and is_set else ""
    row = column.column(heading=f"{info.label}{unit}").row(align=True)
    row.prop(own, switch, text="" if is_set or info.auto is None else auto_text(context, info))
    if is_set:
        row.prop(own, shown_name(info), text="")
    draw_choice(row, context, info)
    if info.unit == BYTES:
        _draw_text_complaint(column, context, info)


def _draw_text_complaint(layout, context, info: SettingInfo) -> None:
    """Draw in red why the text that a number of bytes is kept as means none: the number beside it is 0 then."""
    try:
        parse_setting(info.name, getattr(context.scene.raybatch, info.name))
    except SettingsError as error:
        draw_box(layout, context, str(error), "ERROR", alert=True)


def _draw_complaint(layout, context) -> None:
    """Draw why settings do not go together, before a render is tried."""
    try:
        settings_from(context.scene)
    except SettingsError as error:
        draw_box(layout, context, str(error), "ERROR")


def _draw_switch(self, context):
    own, name = context.scene.raybatch, _IN_HEADER[self.group]
    row = self.layout.row()
    # what cannot be had can be turned off, where another computer turned it on
    row.enabled = getattr(own, name) == "ON" or not why_not(own.denoise_library)
    row.prop(own, switch_name(SETTINGS[name]), text="")


def _draw_presets(self, _context):
    _PRESETS[self.group].draw_panel_header(self.layout)


def _panel_name(group: str) -> str:
    return f"RAYBATCH_RENDER_PT_{group.lower()}"


def _panel(group: str, info: GroupInfo) -> type:
    values = {
        "__doc__": info.description,
        "bl_label": info.label,
        "bl_options": {"DEFAULT_CLOSED"} if info.closed else set(),
        "group": group,
        "draw": _draw,
    }
    if group in _LATER:
        values["bl_order"] = LATER
    if group in _IN_HEADER:
        values["draw_header"] = _draw_switch
    if group in _PRESETS:
        values["draw_header_preset"] = _draw_presets
    if info.parent:
        values["bl_parent_id"] = _panel_name(info.parent)
    return type(_panel_name(group), (EnginePanel, bpy.types.Panel), values)


_classes = tuple(_panel(name, info) for name, info in GROUPS.items())


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
