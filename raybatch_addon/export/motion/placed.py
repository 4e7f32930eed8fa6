"""The key of a placement, by which it is found again at another time."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import bpy
    import numpy as np


class PlacedMotion(NamedTuple):
    """A placement as it is found again at another time, and how it may move."""

    key: tuple
    mesh: int
    steps: int  # of its map
    deforms: bool  # its vertices may move
    velocity: np.ndarray | None = None  # of its vertices [m/s], shape [vertex_count, 3]
    item: int = 0  # of the depsgraph's list, which may have been placed as several things


def placed_key(placed: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object) -> tuple:
    """The key by which a placement is known at any time."""
    parent = placed.parent.original.as_pointer() if placed.parent else 0
    return obj.original.as_pointer(), parent, placed.is_instance, tuple(placed.persistent_id)
