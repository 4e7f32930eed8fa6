"""Tune: schedules are tried on the scene, and the fastest is offered."""

from __future__ import annotations

from ..panel import register_all, unregister_all
from . import operators, panel

_parts = (operators, panel)


def register() -> None:
    """Add operators and panel."""
    register_all(_parts)


def unregister() -> None:
    """Remove them."""
    unregister_all(_parts)
