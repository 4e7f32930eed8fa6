"""Edits, sorted by what must be read again: taken from Blender's list of what it evaluated anew."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy

# Kinds of data that no material is compiled from
_WITHOUT_GRAPH = {
    "Object",
    "Mesh",
    "Curve",
    "Curves",
    "PointCloud",
    "Volume",
    "MetaBall",
    "TextCurve",
    "SurfaceCurve",
    "Lattice",
    "Armature",
    "Camera",
    "Scene",
    "Collection",
    "World",
    "Material",
    "Key",
    "Action",
}
_OWNERS = {"Material", "World"}
_WITH_GRAPH = {"ShaderNodeTree"}


@dataclass(frozen=True)
class Update:
    """An entry of Blender's list (`Depsgraph.updates`)."""

    kind: str  # Blender's name of the type: Object, Mesh, Material, ...
    uid: int  # `session_uid` of the original
    transform: bool = False
    geometry: bool = False
    shading: bool = False


@dataclass
class Edits:
    """Changes since the scene was read last."""

    moved: set[int] = field(default_factory=set)  # objects that are elsewhere and otherwise the same
    reshaped: set[int] = field(default_factory=set)  # objects and data of another shape
    materials: set[int] = field(default_factory=set)  # materials that are others now
    any_material: bool = True  # all of them may be
    is_whole: bool = False  # the scene is to be gone through: more changed than places of objects

    def __bool__(self) -> bool:
        return bool(self.moved or self.reshaped or self.is_whole)

    def add(self, updates: Iterable[Update]) -> None:
        """Take `updates` too."""
        updates = list(updates)
        kinds = {each.kind for each in updates}
        # a tree comes with what it belongs to, unless it is a group of its own
        known = _WITHOUT_GRAPH | (
            _WITH_GRAPH if kinds & _OWNERS or any(kind.endswith("Light") for kind in kinds) else set()
        )
        for each in updates:
            if each.kind == "Material":
                self.materials.add(each.uid)
            elif each.kind not in known and not each.kind.endswith("Light"):
                self.any_material = True
            if each.kind == "Object" and each.transform and not each.geometry and not each.shading:
                self.moved.add(each.uid)
                continue
            self.is_whole = True
            if each.geometry:
                self.reshaped.add(each.uid)

    def forgotten(self) -> None:
        """What was known of shapes and materials that are others now was forgotten."""
        self.reshaped, self.materials, self.any_material = set(), set(), False

    def clear(self) -> None:
        """All was read."""
        self.forgotten()
        self.moved, self.is_whole = set(), False


def updates_of(depsgraph: bpy.types.Depsgraph) -> list[Update]:
    """Blender's list as plain values."""
    return [
        Update(
            # subclasses of types (an area light, a shader tree) count as what they are
            type(each.id).__name__,
            each.id.original.session_uid,
            each.is_updated_transform,
            each.is_updated_geometry,
            each.is_updated_shading,
        )
        for each in depsgraph.updates
    ]
