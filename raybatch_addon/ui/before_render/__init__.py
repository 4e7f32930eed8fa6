"""Notices shown before a render: what it would lack, and settings of other engines that it could take over."""

from __future__ import annotations

from ..panel import register_all, unregister_all
from . import operators, panel, properties

_parts = (properties, operators, panel)


def register() -> None:
    """Add properties, operators and panels."""
    register_all(_parts)


def unregister() -> None:
    """Remove all of it."""
    unregister_all(_parts)
