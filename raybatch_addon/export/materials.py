"""Blender's materials as the core's `Material`s."""

from __future__ import annotations

from typing import Any

import bpy

from ..core.programs.builder import Value
from ..core.scene.description import Closure, ClosureKind, Material
from .kept_materials import KeptMaterials
from .nodes.collections import Collections
from .nodes.compile import compile_graph
from .nodes.graph import find_source
from .nodes.shaders.principled import KINDS as PRINCIPLED_KINDS
from .nodes.shaders.principled import Layers, layered_closures
from .world import has_nodes

_DEFAULT_GREY = (0.8, 0.8, 0.8)  # Blender's surface without a material
# Most objects that a message about their material names
_NAMED_USERS = 3


class ExportedMaterials:
    """The materials of one scene, each exported once, in the order of their first use."""

    def __init__(self, collections: Collections | None = None) -> None:
        self.collections = collections or Collections()
        self._kept = KeptMaterials(self.collections)
        self.materials: list[Material] = []
        # for each material: kind and name of the attributes that it reads
        self.asked: list[frozenset[tuple[str, str]]] = []
        self._index: dict[Any, int] = {}
        self._notes: dict[int, list[str]] = {}  # for each material: messages about parts that were left out
        self._users: dict[int, list[str]] = {}

    def index(self, material: bpy.types.Material | None, user: str) -> int:
        """The index of `material` (None: Blender's default grey), used by the object called `user`."""
        key = None if material is None else material.original.as_pointer()
        if key not in self._index:
            self._index[key] = len(self.materials)
            exported, notes = self._export(material)
            self.materials.append(exported)
            self.asked.append(frozenset(self.collections.asked))
            if notes:
                self._notes[self._index[key]] = notes
        index = self._index[key]
        if index in self._notes:
            users = self._users.setdefault(index, [])
            if user not in users:
                users.append(user)
        return index

    def _export(self, material: bpy.types.Material | None) -> tuple[Material, list[str]]:
        self.collections.begin()
        signature = self._kept.signature(material)
        found = self._kept.find(material, signature) if signature is not None else None
        if found is None:
            self.collections.begin()
            found = export_material(material, self.collections)
            if signature is not None:
                self._kept.keep(material, signature, *found)
        return found

    def warnings(self) -> list[str]:
        """One line for each material that is not rendered as it is: its name, its nodes, its objects."""
        lines = []
        for index, notes in self._notes.items():
            users = self._users[index]
            named = ", ".join(f"“{name}”" for name in users[:_NAMED_USERS])
            more = f" and {len(users) - _NAMED_USERS} more" if len(users) > _NAMED_USERS else ""
            lines.append(f"material “{self.materials[index].name}” of {named}{more}: {'; '.join(notes)}")
        return lines


def export_material(
    material: bpy.types.Material | None, collections: Collections | None = None
) -> tuple[Material, list[str]]:
    """`material`, and messages about its parts that are not rendered as they are.

    Parts of a graph that are not understood are replaced; `collections` gets the images and attributes that programs
    refer to by index.
    """
    collections = collections or Collections()
    if material is None:
        return Material("default", (Closure(ClosureKind.DIFFUSE, _DEFAULT_GREY),), (ClosureKind.DIFFUSE,)), []
    if not has_nodes(material):
        return Material(material.name, _viewport_closures(material), tuple(sorted(PRINCIPLED_KINDS))), []
    tree = material.node_tree
    output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL") or tree.get_output_node("EEVEE")
    if output is None:
        return Material(material.name), []
    linked = {name for name in ("Surface", "Volume", "Displacement") if find_source(output.inputs[name])[0] is not None}
    notes = ["not supported yet and left out: volume"] if "Volume" in linked else []
    if "Displacement" in linked and material.displacement_method != "BUMP":
        notes.append("displacement is rendered as bump: the surface stays where it is")
    if "Volume" in linked and "Surface" not in linked:  # a volume alone has no surface
        return Material(
            material.name, (Closure(ClosureKind.TRANSPARENT, (1.0, 1.0, 1.0)),), (ClosureKind.TRANSPARENT,)
        ), notes
    compiled = compile_graph(output.inputs["Surface"], material, collections, "Displacement" in linked)
    return Material(material.name, compiled.closures, compiled.kinds, compiled.program), [*compiled.notes, *notes]


def _viewport_closures(material: bpy.types.Material) -> tuple[Closure, ...]:
    """Closures of a material without nodes."""
    color = tuple(float(c) for c in material.diffuse_color[:3])
    return layered_closures(Layers(Value.of(color), Value.of(material.metallic), Value.of(material.roughness)))
