"""The settings and panels of RayBatch in Blender."""

from __future__ import annotations

from . import (
    before_render,
    builtin_panels,
    checkpoint,
    choices,
    compare,
    convergence,
    devices,
    last_render,
    migration,
    preferences,
    presets,
    properties,
    render_panels,
    tabs,
    tune,
    viewport,
)

_parts = (
    properties,
    migration,
    choices,
    devices,
    presets,
    render_panels,
    checkpoint,
    tune,
    viewport,
    tabs,
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
