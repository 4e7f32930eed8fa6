"""The settings and panels of RayBatch in Blender."""

from __future__ import annotations

from . import (
    before_render,
    builtin_panels,
    checkpoint,
    choices,
    cluster,
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
from .panel import register_all, unregister_all

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
    cluster,
)


def register() -> None:
    """Add all of it."""
    register_all(_parts)


def unregister() -> None:
    """Remove all of it."""
    unregister_all(_parts)
