"""The settings and panels of RayBatch in Blender."""

from __future__ import annotations

from . import (
    before_render,
    builtin_panels,
    camera_panels,
    choices,
    compare,
    convergence,
    data_panels,
    devices,
    last_render,
    light_groups,
    preferences,
    presets,
    properties,
    render_panels,
    shading_panels,
    tune,
    viewport,
)

_parts = (
    properties,
    choices,
    devices,
    presets,
    render_panels,
    tune,
    viewport,
    data_panels,
    shading_panels,
    light_groups,
    camera_panels,
    before_render,
    last_render,
    compare,
    convergence,
    builtin_panels,
    preferences,
)


def register() -> None:
    """Add all of it."""
    for part in _parts:
        part.register()


def unregister() -> None:
    """Remove all of it."""
    for part in reversed(_parts):
        part.unregister()
