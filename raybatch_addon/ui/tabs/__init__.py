"""Panels of objects, materials, lights, cameras, worlds and view layers, and of motion blur and curves."""

from __future__ import annotations

from ..panel import register_all, unregister_all
from . import camera_panels, curves_panel, data_panels, light_groups, shading_panels

_parts = (data_panels, shading_panels, light_groups, camera_panels, curves_panel)


def register() -> None:
    """Add the panels."""
    register_all(_parts)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_parts)
