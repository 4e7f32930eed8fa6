"""The settings in the render tab: one panel a group of settings, made from the core's definitions."""

from __future__ import annotations

import bpy

from ..core.settings import SETTINGS
from .panel import EnginePanel

# group, label, closed at first
_GROUPS = (
    ("DEVICE", "Device", False),
    ("SAMPLING", "Sampling", False),
    ("LIGHT_PATHS", "Light Paths", True),
    ("FILM", "Film", True),
    ("SCHEDULE", "Schedule", True),
)
# Blender's own settings that belong to a group: shown at its end
_BUILTIN = {"FILM": ("film_transparent",)}


def _draw(self, context):
    layout = self.layout
    layout.use_property_split = True
    layout.use_property_decorate = False
    column = layout.column()
    for info in SETTINGS.values():
        if info.group == self.group:
            column.prop(context.scene.raybatch, info.name)
    for name in _BUILTIN.get(self.group, ()):
        column.prop(context.scene.render, name)


def _panel(group: str, label: str, closed: bool) -> type:
    name = f"RAYBATCH_RENDER_PT_{group.lower()}"
    values = {
        "__doc__": f"Settings of the group {group}.",
        "bl_label": label,
        "bl_options": {"DEFAULT_CLOSED"} if closed else set(),
        "group": group,
        "draw": _draw,
    }
    return type(name, (EnginePanel, bpy.types.Panel), values)


_classes = tuple(_panel(*group) for group in _GROUPS)


def register() -> None:
    """Add the panels."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Remove the panels."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
