"""What objects say of their motion (settings of Cycles, where its add-on is enabled), and how they are found again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...core.scene.description import Mesh
from ..meshes.meshes import mesh_velocity


class PlacedMotion(NamedTuple):
    """What finds a placement again at another time, and how it may move."""

    key: tuple
    mesh: int
    steps: int  # of its map
    deforms: bool  # its vertices may move
    velocity: np.ndarray | None = None  # of its vertices [m/s], shape [vertex_count, 3]


def placed_key(placed: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object) -> tuple:
    """What a placement is known by at any time."""
    parent = placed.parent.original.as_pointer() if placed.parent else 0
    return obj.original.as_pointer(), parent, placed.is_instance, tuple(placed.persistent_id)


def object_steps(obj: bpy.types.Object, parent: bpy.types.Object | None) -> int:
    """Times at which an object's place is known while the shutter is open, 2^n + 1; 0: it stands still.

    `parent`: the object that places it, which has a say too.
    """
    settings = [getattr(each, "cycles", None) for each in (obj, parent) if each is not None]
    settings = [each for each in settings if each is not None]
    if not all(each.use_motion_blur for each in settings):
        return 0
    return (2 << (max([1, *(each.motion_steps for each in settings)]) - 1)) + 1


def may_deform(obj: bpy.types.Object, parent: bpy.types.Object | None) -> bool:
    """Whether the vertices of an object may move, as far as they follow from anything."""
    for each in (obj, parent):
        settings = getattr(each, "cycles", None)
        if settings is not None and not settings.use_deform_motion:
            return False
    original = obj.original
    if original.type != "MESH" or original.modifiers or (parent is not None and parent.original.modifiers):
        return True
    data = original.data
    return data.shape_keys is not None or data.animation_data is not None


class PlacedMotions:
    """The motion of placements, looked up once for all that one object places of another's mesh."""

    def __init__(self) -> None:
        self._known: dict[Any, tuple[int, bool, np.ndarray | None]] = {}

    def of(
        self, placed: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object, mesh: int, meshes: Sequence[Mesh]
    ) -> PlacedMotion:
        """That of `placed`, which is `meshes[mesh]`."""
        parent = placed.parent if placed.is_instance else None
        place = (mesh, obj.original.as_pointer(), parent.original.as_pointer() if parent else 0)
        if place not in self._known:
            is_mesh = isinstance(obj.data, bpy.types.Mesh) and meshes[mesh].radii is None
            deforms = is_mesh and may_deform(obj, parent)
            velocity = mesh_velocity(obj.data, meshes[mesh]) if deforms else None
            self._known[place] = object_steps(obj, parent), deforms and velocity is None, velocity
        return PlacedMotion(placed_key(placed, obj), mesh, *self._known[place])
