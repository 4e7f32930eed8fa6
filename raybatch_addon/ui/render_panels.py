"""The settings in the render tab: one panel a group of settings, made from the core's definitions."""

from __future__ import annotations

import bpy

from ..core.settings import BYTES, GROUPS, SETTINGS, SettingInfo
from ..core.setting_info import GroupInfo
from .panel import EnginePanel
from .properties import megabytes_name

# Blender's own settings that belong to a group: shown at its end
_BUILTIN = {"FILM": ("film_transparent",)}


def shown_name(info: SettingInfo) -> str:
    """The property that a panel shows for a setting."""
    return megabytes_name(info) if info.unit == BYTES else info.name


def _draw(self, context):
    layout = self.layout
    layout.use_property_split = True
    layout.use_property_decorate = False
    column = layout.column()
    for info in SETTINGS.values():
        if info.group == self.group:
            column.prop(context.scene.raybatch, shown_name(info))
    for name in _BUILTIN.get(self.group, ()):
        column.prop(context.scene.render, name)


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
