"""Placements: the depsgraph's objects and instances as the core's meshes, `Instances` and lights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from ...core.scene.description import Instances, Light, Mesh, Visibility
from ..lights import LampGraphs, export_light
from ..materials import ExportedMaterials
from ..nodes.collections import OF_INSTANCER
from .attributes import object_value
from .kept_meshes import MeshSource, end_export
from .mesh_shape import hashed
from .meshes import slot_count

# Instances between two checks for a cancelled export
_CANCEL_INTERVAL = 256

# A matrix composed in float32 from a few products has elements wrong by about this much, relatively
_MATRIX_ERROR = 8 * 2.0**-24

_OBJECT_KINDS = {"OBJECT", "INSTANCER", OF_INSTANCER}  # kinds of attributes that belong to objects
_SOLID_TYPES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
_UNSUPPORTED_TYPES = {"VOLUME": "volumes", "CURVES": "hair curves", "POINTCLOUD": "point clouds"}


_RANDOM_MOST = 2**32 - 1  # largest random number of an object


def _random_id(name: str) -> int:
    """The random number of an object that is no instance, as Cycles draws it from the name.

    It is a hash of 32 bits, hashed by lookup3.
    """
    code = 0
    for byte in name.encode():
        code = (code * 37 + (byte if byte < 128 else byte - 256)) & 0xFFFFFFFF
    return int(hashed(np.array([code], np.uint32), words=2)[0])


def _random(placed: bpy.types.DepsgraphObjectInstance) -> float:
    """The random number of a placed object, 0..1."""
    # Blender gives the 32 bits with a sign
    return (placed.random_id & _RANDOM_MOST if placed.is_instance else _random_id(placed.object.name)) / _RANDOM_MOST


class Cancelled(Exception):
    """Raised when the caller of the export asks it to stop."""


@dataclass(frozen=True)
class _Template:
    """Data that all placements of one mesh by one object share."""

    mesh: int
    slot_first: int
    visibility: int
    object: int
    # index and value of each attribute of the object that materials read
    attributes: tuple[tuple[int, tuple[float, ...]], ...] = ()
    # index and name of the attributes that they read of the surface that places each instance
    of_instancer: tuple[tuple[int, str], ...] = ()


@dataclass
class Placements:
    """Everything in the depsgraph that can be placed, collected in one pass."""

    meshes: list[Mesh] = field(default_factory=list)
    materials: ExportedMaterials = field(default_factory=ExportedMaterials)
    slot_materials: list[int] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    object_names: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    _templates: list[_Template] = field(default_factory=list)
    _matrices: list[Any] = field(default_factory=list)
    _info: list[tuple[float, ...]] = field(default_factory=list)  # rows of `Instances.info`
    # instance, index and value of attributes
    _of_instancer: list[tuple[int, int, tuple[float, ...]]] = field(default_factory=list)

    def instances(self) -> Instances:
        """The placements whose matrix can be used; the others are named in `warnings`."""
        count = len(self._templates)
        if count == 0:
            return Instances.empty()
        transform = np.array(self._matrices, np.float32).reshape(count, 4, 4)[:, :3]
        table = np.array([(t.mesh, t.slot_first, t.visibility, t.object) for t in self._templates], np.int32)
        usable = np.ones(count, bool)
        finite = np.isfinite(transform).all(axis=(1, 2))
        singular = finite & is_singular(np.where(finite[:, None, None], transform, 0))
        for bad, reason in (
            (~finite, "its matrix is not finite; reset its location, rotation and scale"),
            (
                singular,
                "it is flattened to nothing (its matrix is singular); give it, and what it is parented to, a scale "
                "that is not 0",
            ),
        ):
            usable &= ~bad
            for index, times in zip(*np.unique(table[bad, 3], return_counts=True)):
                how_often = f" ({times:,} instances)" if times > 1 else ""
                self.warnings.append(f"object “{self.object_names[index]}”{how_often} is left out: {reason}")
        mesh, slot_first, visibility, owner = np.ascontiguousarray(table[usable].T)
        asked = any(m.program is not None and "object_info" in m.program.ops for m in self.materials.materials)
        info = np.array(self._info, np.float32).reshape(count, 6)[usable] if asked else None
        return Instances(
            mesh, np.ascontiguousarray(transform[usable]), slot_first, visibility, owner, info, self._attributes(usable)
        )

    def _attributes(self, usable: np.ndarray) -> np.ndarray | None:
        """The array of `Instances.attributes`."""
        asked = len(self.materials.collections.object_attributes)
        if not asked:
            return None
        values = np.zeros((len(self._templates), asked, 4), np.float32)
        for i, template in enumerate(self._templates):
            for index, value in template.attributes:
                values[i, index] = value
        for i, index, value in self._of_instancer:
            values[i, index] = value
        return values[usable]


def _with_attributes(light: Light, values: tuple[tuple[int, tuple[float, ...]], ...], placements: Placements) -> Light:
    """`light` with the values of its object's attributes, by their indices among all."""
    if not values:
        return light
    attributes = np.zeros((len(placements.materials.collections.object_attributes), 4), np.float32)
    for index, value in values:
        attributes[index] = value
    return replace(light, attributes=attributes)


def _named(names: list[str]) -> str:
    return ", ".join(f"“{name}”" for name in dict.fromkeys(names))


def _position_on_surface(placed: bpy.types.DepsgraphObjectInstance, name: str) -> tuple[float, ...]:
    """Position of an instance on the surface that places it: its generated coordinates as in Cycles, or its `uv`."""
    if name == "uv":
        return (*placed.uv, 0.0, 1.0)
    return (*(0.5 * x - 0.5 for x in placed.orco), 1.0)


def is_singular(transform: np.ndarray) -> np.ndarray:
    """Whether matrices [n, 3 or more, 4] collapse space, as far as float32 can show: bool, shape [n].

    The determinant is at most the product of the columns' lengths (Hadamard), and known to within the error of the
    elements relative to that product.
    """
    linear = transform[:, :3, :3].astype(np.float64)
    return np.abs(np.linalg.det(linear)) <= _MATRIX_ERROR * np.linalg.norm(linear, axis=1).prod(axis=1)


def collect_placements(depsgraph: bpy.types.Depsgraph, cancelled: Callable[[], bool]) -> Placements:
    """One pass over the objects and instances of `depsgraph`. Raises `Cancelled`."""
    collector = _Collector(depsgraph)
    try:
        for count, placed in enumerate(depsgraph.object_instances):
            if count % _CANCEL_INTERVAL == 0 and cancelled():
                raise Cancelled
            collector.add(placed, cancelled)
        return collector.finish()
    finally:
        end_export()


class _Collector:
    """Pass over a depsgraph. The iterator's objects are temporary: only copies and keys of them are kept."""

    def __init__(self, depsgraph: bpy.types.Depsgraph) -> None:
        self.view_layer = depsgraph.view_layer
        # evaluated: with the nodes as drivers and keyframes have them now
        self.material_override = depsgraph.view_layer_eval.material_override
        self.viewport = depsgraph.mode != "RENDER"
        self.placements = Placements()
        collections = self.placements.materials.collections
        collections.frame = depsgraph.scene.frame_current
        collections.scene, collections.view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval
        self._lamp_graphs = LampGraphs(collections)
        self._templates: dict[Any, _Template | None] = {}
        self._meshes: dict[Any, int | None] = {}
        self._attributes_seen: dict[Any, set[tuple[str, str]]] = {}  # attributes read, by mesh
        self._object_index: dict[str, int] = {}
        self._unsupported: dict[str, list[str]] = {}
        # objects that lack an attribute which their materials read, by attribute
        self._lacking: dict[str, list[str]] = {}
        self._visibilities: dict[int, int] = {}
        self._light_values: list[tuple[tuple[int, tuple[float, ...]], ...]] = []  # by light: as `_Template.attributes`

    def add(self, placed: bpy.types.DepsgraphObjectInstance, cancelled: Callable[[], bool]) -> None:
        """Take one item of the depsgraph's list."""
        obj = placed.object
        kind = obj.type
        of_itself = not placed.is_instance or (placed.parent is not None and placed.parent.original == obj.original)
        if of_itself and self.viewport and obj.original.hide_render:
            return  # a render's own depsgraph leaves these out by itself
        if not placed.is_instance:
            self._note_unsupported(obj, placed)
        if kind == "LIGHT":
            self._add_light(placed, obj)
            return
        # Curves, text, surfaces and metaballs come twice: as themselves, and as an instance of their evaluated mesh
        if kind not in _SOLID_TYPES or not placed.show_self or not isinstance(obj.data, bpy.types.Mesh):
            return
        if not self.view_layer.use_solid:
            return
        data = obj.data
        key = (
            obj.original.as_pointer(),
            placed.parent.original.as_pointer() if placed.parent else 0,
            data.as_pointer(),
            data.session_uid,
        )
        if key not in self._templates:
            if cancelled():
                raise Cancelled
            self._templates[key] = self._template(placed, obj, data)
        template = self._templates[key]
        if template is not None:
            if placed.is_instance:
                instance = len(self.placements._templates)
                for index, name in template.of_instancer:
                    self.placements._of_instancer.append((instance, index, _position_on_surface(placed, name)))
            self.placements._templates.append(template)
            self.placements._matrices.append([tuple(row) for row in placed.matrix_world])
            self.placements._info.append((*obj.color, float(obj.pass_index), _random(placed)))

    def finish(self) -> Placements:
        """All placements, with the warnings that need the whole list."""
        placements = self.placements
        placements.lights = [
            _with_attributes(light, values, placements) for light, values in zip(placements.lights, self._light_values)
        ]
        for what, names in self._unsupported.items():
            placements.warnings.append(f"{what} not supported yet: {_named(names)}")
        for attribute, names in self._lacking.items():
            placements.warnings.append(
                f"there is no attribute “{attribute}” on objects whose materials ask for it, and it counts as 0: "
                f"{_named(names)}"
            )
        placements.warnings += placements.materials.warnings()
        return placements

    def _add_light(self, placed, obj) -> None:
        placements = self.placements
        light = export_light(obj, placed.matrix_world.copy(), placements.warnings, self._lamp_graphs, _random(placed))
        if light is not None:
            asked = sorted(
                each for each in self._lamp_graphs.of(obj.data).asked if each[0] in _OBJECT_KINDS - {OF_INSTANCER}
            )
            self._light_values.append(self._object_values(obj, placed.parent, asked))
            placements.lights.append(light)

    def _template(self, placed, obj, data) -> _Template | None:
        visibility = self._visibility(obj)
        if placed.is_instance and placed.parent is not None:
            visibility &= self._visibility(placed.parent)
        if visibility == 0:
            return None
        wanted = self._materials(obj, data)
        asked = set().union(*(self.placements.materials.asked[index] for index in wanted))
        mesh = self._mesh(obj, data, sorted((kind, name) for kind, name in asked if kind not in _OBJECT_KINDS))
        if mesh is None:
            return None
        first = len(self.placements.slot_materials)
        self.placements.slot_materials += wanted
        collections = self.placements.materials.collections
        of_instancer = tuple(
            (collections.object_attribute(kind, name), name) for kind, name in sorted(asked) if kind == OF_INSTANCER
        )
        values = self._object_values(
            obj, placed.parent, sorted(each for each in asked if each[0] in _OBJECT_KINDS - {OF_INSTANCER})
        )
        return _Template(mesh, first, visibility, self._name_index(obj.name), values, of_instancer)

    def _mesh(self, obj, data, asked: list[tuple[str, str]]) -> int | None:
        """Index of the mesh, with the attributes `asked`; None if it has no triangles."""
        key = (data.as_pointer(), data.session_uid)
        known = key in self._meshes
        index = self._meshes.get(key)
        if known and (index is None or self._attributes_seen[key].issuperset(asked)):
            return index
        # A mesh that is being edited has its triangles elsewhere, until it is asked for as a mesh
        edited = data.is_editmode
        meshes = self.placements.meshes
        source = MeshSource(obj.to_mesh() if edited else data, obj.name, self.placements.warnings)
        if not known:
            exported = source.exported()
            index = self._meshes[key] = None if exported is None else len(meshes)
            if exported is not None:
                meshes.append(exported)
        if index is not None:
            seen = self._attributes_seen.setdefault(key, set())
            added = source.attributes(each for each in asked if each not in seen)
            if added:
                meshes[index] = replace(meshes[index], attributes=(*meshes[index].attributes, *added))
            seen.update(asked)
        if edited:
            obj.to_mesh_clear()
        return index

    def _object_values(self, obj, parent, asked: list[tuple[str, str]]) -> tuple[tuple[int, tuple[float, ...]], ...]:
        """Indices and values of the object's attributes `asked`."""
        values = []
        for kind, name in asked:
            value = object_value(obj, parent, kind, name)
            if value is None:
                self._lacking.setdefault(name, []).append(obj.name)
            else:
                values.append((self.placements.materials.collections.object_attribute(kind, name), value))
        return tuple(values)

    def _materials(self, obj, data) -> list[int]:
        """The materials of the object's slots."""
        slots = obj.material_slots
        wanted = []
        for i in range(slot_count(data)):
            material = slots[i].material if i < len(slots) else data.materials[i] if i < len(data.materials) else None
            material = self.material_override or material
            wanted.append(self.placements.materials.index(material, obj.name))
        return wanted

    def _visibility(self, obj) -> int:
        original = obj.original
        key = original.as_pointer()
        if key not in self._visibilities:
            seen = Visibility(0)
            for ray in Visibility:
                if getattr(obj, f"visible_{ray.name.lower()}"):
                    seen |= ray
            if original.indirect_only_get(view_layer=self.view_layer):
                seen &= ~Visibility.CAMERA
            self._visibilities[key] = int(seen)
        return self._visibilities[key]

    def _name_index(self, name: str) -> int:
        if name not in self._object_index:
            self._object_index[name] = len(self.placements.object_names)
            self.placements.object_names.append(name)
        return self._object_index[name]

    def _note_unsupported(self, obj, placed) -> None:
        """Remember by name the parts of `obj` that are not rendered as they are."""
        if obj.type in _UNSUPPORTED_TYPES:
            self._note(f"{_UNSUPPORTED_TYPES[obj.type]} (left out) are", obj.name)
        if obj.type not in _SOLID_TYPES:
            return
        if obj.is_holdout or obj.original.holdout_get(view_layer=self.view_layer):
            self._note("holdout (rendered as an ordinary object) is", obj.name)
        if obj.is_shadow_catcher:
            self._note("shadow catcher (rendered as an ordinary object) is", obj.name)
        if placed.show_particles:
            for system in obj.particle_systems:
                if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                    self._note("particle hair (left out) is", f"{obj.name}/{system.name}")

    def _note(self, what: str, name: str) -> None:
        self._unsupported.setdefault(what, []).append(name)
