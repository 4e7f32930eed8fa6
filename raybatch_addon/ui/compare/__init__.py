"""The last renders in Blender's slots, to compare: what each was rendered with, and how long it took."""

from __future__ import annotations

from . import panel, slots

_parts = (slots, panel)


def register() -> None:
    """Add operators and panel, and have renders noted."""
    for part in _parts:
        part.register()


def unregister() -> None:
    """Remove them."""
    for part in reversed(_parts):
        part.unregister()
