"""Panels of objects, materials, lights, cameras, worlds and view layers, and of motion blur."""

from __future__ import annotations

from . import camera_panels, data_panels, light_groups, shading_panels

_parts = (data_panels, shading_panels, light_groups, camera_panels)


def register() -> None:
    """Add the panels."""
    for part in _parts:
        part.register()


def unregister() -> None:
    """Remove the panels."""
    for part in reversed(_parts):
        part.unregister()
