"""The settings in the render tab: one panel a group of settings, made from the core's definitions."""

from __future__ import annotations

import bpy

from ..blender.denoise_library import why_not
from ..core.errors import SettingsError
from ..core.settings.info import GroupInfo
from ..core.settings.settings import BYTES, GROUPS, SETTINGS, SettingInfo, parse_setting
from ..export.settings import settings_from
from .choices import draw_choice
from .memory import estimate_lines
from .panel import EnginePanel, draw_lines
from .presets import RAYBATCH_MT_schedule_presets
from .properties import megabytes_name

# Blender's own settings that belong to a group: shown at its end
_BUILTIN = {"FILM": ("film_transparent",)}
_SCHEDULE = "PERFORMANCE"


def shown_name(info: SettingInfo) -> str:
    """The property that a panel shows for a setting."""
    return megabytes_name(info) if info.unit == BYTES else info.name


def _draw(self, context):
    layout = self.layout
    layout.use_property_split = True
    layout.use_property_decorate = False
    missing = why_not(context.scene.raybatch.denoise_library) if self.group == "DENOISING" else ""
    column = layout.column()
    for info in SETTINGS.values():
        if info.group == self.group:
            row = column.row(align=True)
            row.active = _is_heard(context.scene.raybatch, info.name)
            row.enabled = not missing or info.name == "denoise_library"
            row.prop(context.scene.raybatch, shown_name(info))
            draw_choice(row, context, info)
            if info.unit == BYTES:
                _draw_text_complaint(column, context, info)
    if missing:
        draw_lines(layout.box(), context, [missing], "INFO")
    for name in _BUILTIN.get(self.group, ()):
        column.prop(context.scene.render, name)
    if self.group == "FILM":
        column.prop(context.scene.raybatch_export, "exposure")
    if self.group == _SCHEDULE:
        _draw_complaint(layout, context)
    elif self.group == "MEMORY":
        draw_lines(layout, context, estimate_lines(context))


def _is_heard(settings, name: str) -> bool:
    """Whether a setting has a say: no other already says what it would, or leaves nothing to say."""
    if name.startswith("denoise_"):
        guided = name != "denoise_prefilter" or settings.denoise_inputs != "NONE"
        return name == "denoise_library" or (settings.denoise == "ON" and guided)
    is_adaptive = settings.adaptive_sampling == "ON"
    if name == "error_estimate":
        return not (settings.error_target > 0 or is_adaptive)
    return is_adaptive or name not in ("noise_threshold", "adaptive_samples_min")


def _draw_text_complaint(layout, context, info: SettingInfo) -> None:
    """Draw in red why the text that a number of bytes is kept as means none: the number beside it is 0 then."""
    try:
        parse_setting(info.name, getattr(context.scene.raybatch, info.name))
    except SettingsError as error:
        box = layout.box()
        box.alert = True
        draw_lines(box, context, [str(error)], "ERROR")


def _draw_complaint(layout, context) -> None:
    """Draw why settings do not go together, before a render is tried."""
    try:
        settings_from(context.scene)
    except SettingsError as error:
        draw_lines(layout.box(), context, [str(error)], "ERROR")


def _draw_presets(self, _context):
    self.layout.menu(RAYBATCH_MT_schedule_presets.__name__, text="", icon="PRESET")


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
    if group == _SCHEDULE:
        values["draw_header_preset"] = _draw_presets
    if info.parent:
        values["bl_parent_id"] = _panel_name(info.parent)
    return type(_panel_name(group), (EnginePanel, bpy.types.Panel), values)


_classes = tuple(_panel(name, info) for name, info in GROUPS.items())


def register() -> None:
    """Add the panels."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Remove the panels."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
