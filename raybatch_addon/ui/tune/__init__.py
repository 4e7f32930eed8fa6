"""Tune: schedules are tried on the scene, and the fastest is offered."""

from __future__ import annotations

from . import operators, panel

_parts = (operators, panel)


def register() -> None:
    """Add operators and panel."""
    for part in _parts:
        part.register()


def unregister() -> None:
    """Remove them."""
    for part in reversed(_parts):
        part.unregister()
