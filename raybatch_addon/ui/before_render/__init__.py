"""What is known before a render: what it would lack, and settings of other engines that it could take over."""

from __future__ import annotations

from . import operators, panel, properties

_parts = (properties, operators, panel)


def register() -> None:
    """Add properties, operators and panels."""
    for part in _parts:
        part.register()


def unregister() -> None:
    """Remove all of it."""
    for part in reversed(_parts):
        part.unregister()
