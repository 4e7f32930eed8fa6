"""Motion settings of objects: those of Cycles, where its add-on is enabled."""

from __future__ import annotations

from collections.abc import Hashable

import bpy
import numpy as np

from ..meshes.meshes import mesh_velocity
from ..meshes.placements import Placements
from .placed import PlacedMotion, placed_key


def object_steps(obj: bpy.types.Object, parent: bpy.types.Object | None) -> int:
    """Times at which an object's place is known while the shutter is open, 2^n + 1; 0: it stands still.

    `parent`: the object that places it, which has a say too.
    """
    found = [getattr(each, "cycles", None) for each in (obj, parent) if each is not None]
    settings = [each for each in found if each is not None]
    if not all(each.use_motion_blur for each in settings):
        return 0
    return (2 << (max([1, *(each.motion_steps for each in settings)]) - 1)) + 1


def _moves_vertices(obj: bpy.types.Object, parent: bpy.types.Object | None) -> bool:
    settings = [getattr(each, "cycles", None) for each in (obj, parent)]
    return all(each is None or each.use_deform_motion for each in settings)


def may_deform(obj: bpy.types.Object, parent: bpy.types.Object | None, hair: bool = False) -> bool:
    """Whether the vertices of an object may move, as far as they follow from anything; or the `hair` on it."""
    if not _moves_vertices(obj, parent):
        return False
    original, modifiers = obj.original, list(obj.original.modifiers)
    if hair:
        modifiers = [each for each in modifiers if each.type != "PARTICLE_SYSTEM" or _has_moving_hair(each)]
    if parent is not None:
        modifiers += parent.original.modifiers
    if original.type not in _STILL_TYPES or modifiers or original.parent_type in _DEFORMING_PARENTS:
        return True
    data = original.data
    return getattr(data, "shape_keys", None) is not None or data.animation_data is not None


# Their vertices move by modifiers, shape keys and animation alone
_STILL_TYPES = ("MESH", "CURVES", "POINTCLOUD")
# Ways to follow a parent that bend what follows, as a modifier would
_DEFORMING_PARENTS = ("ARMATURE", "LATTICE")


def _has_moving_hair(modifier: bpy.types.Modifier) -> bool:
    system = modifier.particle_system
    settings = system.settings
    return system.use_hair_dynamics or settings.animation_data is not None or settings.force_field_1.type != "NONE"


class PlacedMotions:
    """The motion of placements, looked up once for all that one object places of another's mesh."""

    def __init__(self) -> None:
        self._known: dict[Hashable, tuple[int, bool, np.ndarray | None]] = {}

    def of(
        self, placed: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object, mesh: int, made: Placements, item: int
    ) -> PlacedMotion:
        """The motion of `placed`, number `item` of the depsgraph's list, which is mesh number `mesh` of `made`."""
        parent = placed.parent if placed.is_instance else None
        place = (mesh, obj.original.as_pointer(), parent.original.as_pointer() if parent else 0)
        if place not in self._known:
            strands = made.strands.get(mesh)
            is_mesh = isinstance(obj.data, bpy.types.Mesh) and strands is None
            hair = isinstance(obj.data, bpy.types.Mesh) and strands is not None
            velocity = None
            if _moves_vertices(obj, parent):
                if strands is not None:
                    velocity = strands.velocity(made.warnings)
                elif is_mesh:
                    velocity = mesh_velocity(obj.data, made.meshes[mesh], obj.name, made.warnings)
            deforms = (is_mesh or strands is not None) and (velocity is not None or may_deform(obj, parent, hair))
            self._known[place] = object_steps(obj, parent), deforms and velocity is None, velocity
        return PlacedMotion(placed_key(placed, obj), mesh, *self._known[place], item)
