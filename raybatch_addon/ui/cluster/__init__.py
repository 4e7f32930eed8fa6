"""Render on Cluster: the file is rendered by a command line, whose progress and picture Blender shows."""

from __future__ import annotations

from ..panel import register_all, unregister_all
from . import operators, panel

_parts = (operators, panel)


def register() -> None:
    """Add operators and panel."""
    register_all(_parts)


def unregister() -> None:
    """Remove them, and end what they began."""
    unregister_all(_parts)
