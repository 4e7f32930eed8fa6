"""The last renders in Blender's slots, to compare: what each was rendered with, and how long it took."""

from __future__ import annotations

from ..panel import register_all, unregister_all
from . import panel, slots

_parts = (slots, panel)


def register() -> None:
    """Add operators and panel, and have renders noted."""
    register_all(_parts)


def unregister() -> None:
    """Remove them."""
    unregister_all(_parts)
