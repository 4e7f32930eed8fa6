"""Meshes that a viewport read before and need not be read again: those of objects that no edit touched since.

Blender lists each object whose geometry it evaluated anew. All others have the mesh that they had, at the same
address; so it need not even be looked at. No pointer is followed that an earlier call got: addresses are keys alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

import bpy

from ...core.scene.description import Attribute, Mesh
from ..kept_materials import UntouchedMaterials
from .kept_meshes import MeshSource, use_again


@dataclass
class _Known:
    """A mesh as it was read."""

    mesh: Mesh | None  # without attributes
    shape: bytes  # its digest
    notes: list[str]  # messages about it
    data: int  # `session_uid` of the data that it was read from
    pass_count: int  # of the last pass that used it
    owners: set[int] = field(default_factory=set)  # `session_uid`s of objects whose mesh it is
    # what materials asked for, and what of it there was, by kind and name
    attributes: dict[tuple[str, str], list[Attribute]] = field(default_factory=dict)


class LiveMeshes:
    """Meshes that passes over the depsgraph of one viewport leave for the next one."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, int], _Known] = {}  # by address and `session_uid` of evaluated data
        self._pass_count = 0
        self.space: bpy.types.SpaceView3D | None = None  # during a slice of a pass
        self.materials = UntouchedMaterials()
        self.read_count = 0  # meshes that were read, in all passes
        # of each placement of the pass: `session_uid` of its object, 0 where another object places it
        self.owners: list[int] = []
        self.instancers: set[int] = set()  # objects that place others

    def begin(self, changed: Collection[int]) -> None:
        """A pass begins; objects and data of `changed` have another shape than before."""
        self._pass_count += 1
        self.owners, self.instancers = [], set()
        for key, each in list(self._known.items()):
            if each.data in changed or not each.owners.isdisjoint(changed):
                del self._known[key]

    def end(self, is_whole: bool) -> None:
        """The pass is over. After a whole one nothing is kept that it did not come by."""
        if is_whole:
            for key in [key for key, each in self._known.items() if each.pass_count != self._pass_count]:
                del self._known[key]

    def clear(self) -> None:
        """Forget all."""
        self._known.clear()

    def shows(self, placed: bpy.types.DepsgraphObjectInstance) -> bool:
        """Whether the viewport shows what is placed: it may look at some objects alone."""
        if self.space is None:
            return True
        owner = placed.parent if placed.is_instance and placed.parent is not None else placed.object
        return owner.visible_in_viewport_get(self.space)  # evaluated: an original knows of no local collections

    def note_placed(self, placed: bpy.types.DepsgraphObjectInstance) -> None:
        """Remember whose the next placement is."""
        if placed.is_instance:
            self.owners.append(0)
            if placed.parent is not None:
                self.instancers.add(placed.parent.original.session_uid)
        else:
            self.owners.append(placed.object.original.session_uid)

    def source(
        self, obj: bpy.types.Object, data: bpy.types.ID, read: Callable[[], MeshSource], warnings: list[str]
    ) -> LiveSource:
        """The mesh of `obj`, which `read()` reads where it is not known."""
        key, owner = (data.as_pointer(), data.session_uid), obj.original.session_uid
        known = self._known.get(key)
        # another object's mesh may have come to lie where one was; in one pass the address shows
        if known is not None and owner not in known.owners and known.pass_count != self._pass_count:
            known = None
        if known is None:
            self.read_count += 1
            before = len(warnings)
            source = read()
            mesh = source.exported()
            original = obj.original.data
            uid = original.session_uid if original is not None else 0
            known = self._known[key] = _Known(mesh, source.shape, warnings[before:], uid, self._pass_count)
        else:
            if known.pass_count != self._pass_count:
                use_again(known.shape)
                warnings += known.notes
            source = None
        known.pass_count = self._pass_count
        known.owners.add(owner)
        return LiveSource(known, read, source)


class LiveSource:
    """A `MeshSource` that reads a mesh only for what is not known of it."""

    def __init__(self, known: _Known, read: Callable[[], MeshSource], source: MeshSource | None) -> None:
        self._known, self._read, self._source = known, read, source

    def exported(self) -> Mesh | None:
        """See `MeshSource.exported`."""
        return self._known.mesh

    def attributes(self, asked: Iterable[tuple[str, str]]) -> list[Attribute]:
        """See `MeshSource.attributes`."""
        found: list[Attribute] = []
        for key in asked:
            if key not in self._known.attributes:
                self._source = self._source or self._read()
                self._known.attributes[key] = self._source.attributes([key])
            found += self._known.attributes[key]
        return found
