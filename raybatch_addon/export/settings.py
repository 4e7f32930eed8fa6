"""The settings of a Blender scene as the core's `RenderSettings`."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.settings.settings import BYTES, SETTINGS, RenderSettings


def settings_from(scene: bpy.types.Scene) -> RenderSettings:
    """The settings at `scene.raybatch`, or the defaults if the add-on is not registered. Raises `SettingsError`."""
    properties = getattr(scene, "raybatch", None)
    if properties is None:
        return RenderSettings()
    return RenderSettings(**{name: _exact(getattr(properties, name)) for name in SETTINGS})


def assign_setting(properties: bpy.types.PropertyGroup, name: str, value) -> None:
    """Give the setting `name` of `scene.raybatch` a value that `RenderSettings` takes.

    Numbers of bytes are kept as text.
    """
    setattr(properties, name, str(value) if SETTINGS[name].unit == BYTES else value)


def _exact(value):
    # Blender keeps float32: the shortest decimal of the same float32 is the number that was typed, and lies within the
    # range
    return float(str(np.float32(value))) if isinstance(value, float) else value
