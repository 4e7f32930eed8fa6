"""Placements: the depsgraph's objects and instances as the core's meshes, `Instances` and lights."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable
from dataclasses import replace
from operator import attrgetter
from typing import TypeAlias

import bpy

from ...core.scene.description import COPY_SET, Visibility
from ...core.scene.linking import catcher_bits, shadow_bit
from ...core.scene.notice import Notice, Weight
from ..curves.placing import CurveData, StrandMeshes
from ..curves.sources import STRAND_KIND, hair_systems
from ..light_links import LightLinking
from ..lights import LampGraphs, export_light, is_portal
from ..motion.objects import PlacedMotions
from ..motion.shutter import Exposure
from ..nodes.collections import OF_INSTANCER
from ..settings import output_engine
from .attributes import object_value, position_on_surface
from .holdouts import is_holdout, with_hole
from .kept_meshes import MeshSource
from .live_meshes import LiveMeshes, LiveSource
from .meshes import slot_count
from .persistent import known_meshes
from .placements import Placements, Template, row_bytes
from .random_numbers import random_of
from .smoke import any_grids, smoke_domain
from .volumes import export_volume

_CANCEL_INTERVAL = 256  # instances between two checks for a cancelled export
_OBJECT_KINDS = {"OBJECT", "INSTANCER", OF_INSTANCER}  # kinds of attributes that belong to objects
_Placed: TypeAlias = bpy.types.DepsgraphObjectInstance
_Object: TypeAlias = bpy.types.Object
_SOLID_TYPES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
# Bits of rays, and what says whether an object is seen by each
_RAY_BITS = tuple(int(ray) for ray in Visibility)
_seen_by_rays = attrgetter(*(f"visible_{ray.name.lower()}" for ray in Visibility if ray.name))


class Cancelled(Exception):
    """Raised when the caller of the export asks it to stop."""


def _named(names: list[str]) -> str:
    return ", ".join(f"“{name}”" for name in dict.fromkeys(names))


def collect_placements(
    depsgraph: bpy.types.Depsgraph, cancelled: Callable[[], bool], moving: bool = False, blur: Exposure | None = None
) -> Placements:
    """One pass; `moving`: with what finds things again at other times; grids move in `blur`. Raises `Cancelled`."""
    with known_meshes(depsgraph, moving) as known:
        collector = PlacementCollector(depsgraph, moving, known)
        collector.blur = blur
        for count, placed in enumerate(depsgraph.object_instances):
            if count % _CANCEL_INTERVAL == 0 and cancelled():
                raise Cancelled
            collector.add(placed, cancelled)
        return collector.finish()


class PlacementCollector:
    """Pass over a depsgraph. The iterator's objects are temporary: only copies and keys of them are kept."""

    def __init__(self, depsgraph: bpy.types.Depsgraph, moving: bool = False, live: LiveMeshes | None = None) -> None:
        """`live`: as a viewport shows it, with the meshes that are known from passes before."""
        self._live = live
        self._motions = PlacedMotions() if moving else None
        self.blur: Exposure | None = None
        self.viewport = depsgraph.mode != "RENDER"
        self.placements = Placements()
        self.look_at(depsgraph)
        collections = self.placements.materials.collections
        collections.frame = depsgraph.scene.frame_current
        collections.has_grids = any_grids(depsgraph.objects)
        collections.engine = output_engine(depsgraph.scene)
        if live is not None:
            self.placements.materials.begin_live(live.materials)
        self._lamp_graphs = LampGraphs(collections, self.placements.materials.kept)
        # what is placed, and the part of `Placements.info` that is the object's: the mesh as all rays see it, and what
        # the camera sees of a holdout object
        self._placed: dict[Hashable, tuple[list[Template], tuple[float, ...]]] = {}
        # of what one object placed in a row: keys of `_placed`, by the original and its data
        self._parent, self._of_parent = 0, dict[tuple[int, int, int], Hashable]()
        self._meshes: dict[Hashable, int | None] = {}
        self._attributes_seen: dict[Hashable, set[tuple[str, str]]] = {}  # attributes read, by mesh
        self._object_index: dict[str, int] = {}
        self._unsupported: dict[str, list[str]] = {}
        # objects that lack an attribute which their materials read, by attribute
        self._lacking: dict[str, list[str]] = {}
        self._visibilities: dict[int, int] = {}
        self._linking = LightLinking((each.original for each in depsgraph.objects), self.placements.warnings)
        self.placements.linked = bool(self._linking)
        self._groups = {each.name: i for i, each in enumerate(self.view_layer.lightgroups)}
        self.placements.grouped = bool(self._groups)
        layer = depsgraph.view_layer
        self._use_hair, self._use_solid, self._use_volumes = layer.use_strand, layer.use_solid, layer.use_volumes
        self._strands = StrandMeshes(self.placements.meshes, self.placements.warnings, depsgraph.scene)
        self.placements.strands = self._strands.sources
        self._looked_at: set[int] = set()  # pointers of `Placements.originals`
        self._item = -1  # of the depsgraph's list
        self._light_values: list[tuple[tuple[int, tuple[float, ...]], ...]] = []  # by light: as `Template.attributes`

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        """The pass is over `depsgraph`, which is as it was before where the pass goes on."""
        self.view_layer = depsgraph.view_layer
        # evaluated: with the nodes as drivers and keyframes have them now
        self.material_override = depsgraph.view_layer_eval.material_override
        collections = self.placements.materials.collections
        collections.scene, collections.view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval

    def look_away(self) -> None:
        """Keep nothing of Blender's until the pass goes on."""
        self.view_layer = self.material_override = None
        collections = self.placements.materials.collections
        collections.scene = collections.view_layer = None
        self.placements.originals.clear()
        self.placements.materials.forget_graphs()
        self._strands.forget_sources()

    def add(self, placed: _Placed, cancelled: Callable[[], bool]) -> None:
        """Take one item of the depsgraph's list."""
        self._item += 1
        obj, parent = placed.object, placed.parent
        data, original = obj.data, obj.original
        address = original.as_pointer()
        again = None
        if parent is not None and data is not None and self._live is None:
            owner, again = parent.as_pointer(), (address, data.as_pointer(), data.session_uid)
            if owner != self._parent:
                self._parent, self._of_parent = owner, {}
            elif again in self._of_parent:
                self._place(placed, obj, self._of_parent[again])
                return
        kind = obj.type
        if self._live is not None:
            if not self._live.shows(placed):
                return
        elif self.viewport and original.hide_render:
            of_itself = not placed.is_instance or (parent is not None and parent.original == original)
            if of_itself:
                return  # a render's own depsgraph leaves these out by itself
        if address not in self._looked_at:
            self._looked_at.add(address)
            self.placements.originals.append(original)
            self._note_unsupported(obj, placed)
        if kind == "LIGHT":
            self._add_light(placed, obj)
            return
        hair = hair_systems(obj, self.viewport) if self._use_hair and placed.show_particles else []
        for modifier in hair:
            self._add_strands(placed, obj, modifier, cancelled)
        if isinstance(data, (bpy.types.Curves, bpy.types.PointCloud)):
            if placed.show_self and (self._use_hair or isinstance(data, bpy.types.PointCloud)):
                self._add_strands(placed, obj, data, cancelled)
            return
        # Curves, text, surfaces and metaballs come twice: as themselves, and as an instance of their evaluated mesh
        is_solid = self._use_solid and kind in _SOLID_TYPES and isinstance(data, bpy.types.Mesh)
        if not (is_solid or (self._use_volumes and kind == "VOLUME")) or not placed.show_self:
            return
        owner = parent.original.as_pointer() if parent else 0
        key = (address, owner, data.as_pointer(), data.session_uid)
        if key not in self._placed:
            if cancelled():
                raise Cancelled
            wanted = self.materials_of(obj, data)
            self._keep(key, placed, obj, wanted, functools.partial(self._mesh, obj, data))
        self._place(placed, obj, key)
        if again is not None and not hair:
            self._of_parent[again] = key

    def _add_strands(self, placed: _Placed, obj: _Object, data: CurveData, cancelled: Callable[[], bool]) -> None:
        """Curves, points, or the hair of the modifier `data`."""
        owner = placed.parent.original.as_pointer() if placed.parent else 0
        key = (obj.original.as_pointer(), owner, data.as_pointer(), type(data).__name__)
        if key not in self._placed:
            if cancelled():
                raise Cancelled
            self._keep(key, placed, obj, *self._strands.of(obj, data, self))
        self._place(placed, obj, key)

    def _keep(self, key: Hashable, placed: _Placed, obj: _Object, wanted: list[int], mesh: Callable) -> None:
        """Make what is placed for `key`: a template, and that of what the camera sees of a holdout object."""
        template, hole = self._template(placed, obj, wanted, mesh), None
        if template is not None and is_holdout(placed, obj, self.view_layer):
            template, hole = with_hole(template, self.placements, len(wanted))
        templates = [each for each in (template, hole) if each is not None]
        self._placed[key] = templates, (*obj.color, float(obj.pass_index))

    def _place(self, placed: _Placed, obj: _Object, key: Hashable) -> None:
        templates, info = self._placed[key]
        placements = self.placements
        for template in templates:
            if self._live is not None:
                self._live.note_placed(placed)
            if template.of_instancer and placed.is_instance:
                instance = len(placements.templates)
                for index, name in template.of_instancer:
                    placements.of_instancer.append((instance, index, position_on_surface(placed, name)))
            placements.templates.append(template)
            placements.matrices.frombytes(row_bytes(placed.matrix_world))
            if self._motions:
                placements.motion.append(self._motions.of(placed, obj, template.mesh, placements, self._item))
            placements.info.append((*info, random_of(placed)))

    def finish(self) -> Placements:
        """All placements, with the warnings that need the whole list."""
        placements = self.placements
        placements.lights = [
            placements.with_attributes(light, values) for light, values in zip(placements.lights, self._light_values)
        ]
        if not placements.catches:
            placements.lights = [
                replace(each, light_sets=each.light_sets | 1 << COPY_SET) for each in placements.lights
            ]
        for what, names in self._unsupported.items():
            weight = Weight.MISSING if "left out" in what else Weight.REPLACED
            objects = dict.fromkeys(name.partition("/")[0] for name in names)
            placements.warnings.append(Notice(f"{what} not supported yet: {_named(names)}", weight, objects=objects))
        for attribute, names in self._lacking.items():
            text = (
                f"there is no attribute “{attribute}” on objects whose materials ask for it, and it counts as 0: "
                f"{_named(names)}"
            )
            placements.warnings.append(Notice(text, Weight.REPAIRED, objects=dict.fromkeys(names)))
        placements.warnings += placements.materials.warnings()
        return placements

    def _add_light(self, placed: _Placed, obj: _Object) -> None:
        placements = self.placements
        light = export_light(obj, placed.matrix_world.copy(), placements.warnings, self._lamp_graphs, random_of(placed))
        if light is not None and is_portal(obj):
            placements.portals.append(light)
        elif light is not None:
            asked = sorted(
                each for each in self._lamp_graphs.of(obj.data).asked if each[0] in _OBJECT_KINDS - {OF_INSTANCER}
            )
            links = self._linking.of(obj.original)
            if self._linking or self._groups:
                light = replace(
                    light,
                    light_sets=links.lights,
                    shadow_sets=links.shadows,
                    light_group=self._groups.get(obj.lightgroup, -1),
                )
            if not obj.is_shadow_catcher:
                light = replace(light, light_sets=light.light_sets & ~(1 << COPY_SET))
            self._light_values.append(self._object_values(obj, placed.parent, asked))
            placements.lights.append(light)

    def _template(
        self, placed: _Placed, obj: _Object, wanted: list[int], mesh_of: Callable[[list[tuple[str, str]]], int | None]
    ) -> Template | None:
        """`wanted`: materials of the slots. `mesh_of`: index of the mesh with the attributes that these ask for."""
        visibility = self._visibility(obj)
        if placed.is_instance and placed.parent is not None:
            visibility &= self._visibility(placed.parent)
        if visibility == 0:
            return None
        asked = set().union(*(self.placements.materials.asked[index] for index in wanted))
        mesh = mesh_of(sorted((kind, name) for kind, name in asked if kind not in _OBJECT_KINDS))
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
        if obj.is_shadow_catcher or (placed.parent is not None and placed.parent.is_shadow_catcher):
            visibility |= catcher_bits(visibility)
            self.placements.catches = True
        links = self._linking.of(obj.original, placed.parent.original if placed.parent else None)
        if self._linking.links_shadows and visibility & Visibility.SHADOW:
            visibility |= shadow_bit(links.blocker)
        return Template(
            mesh=mesh,
            slot_first=first,
            visibility=visibility,
            object=self._name_index(obj),
            attributes=values,
            of_instancer=of_instancer,
            links=links,
            light_group=self._groups.get(obj.lightgroup, -1),
            terminator=getattr(obj, "shadow_terminator_geometry_offset", 0.0),
        )

    def _mesh(self, obj: _Object, data: bpy.types.ID, asked: list[tuple[str, str]]) -> int | None:
        """Index of the mesh, with the attributes `asked`; None if it has no triangles."""
        key = (data.as_pointer(), data.session_uid)
        if obj.type == "VOLUME" or smoke_domain(obj) is not None:
            return self._volume(obj, key, asked)
        known = key in self._meshes
        index = self._meshes.get(key)
        if known and (index is None or self._attributes_seen[key].issuperset(asked)):
            return index
        # A mesh that is being edited has its triangles elsewhere, until it is asked for as a mesh
        edited = data.is_editmode
        meshes = self.placements.meshes
        source = self._source(obj, data, edited)
        if not known:
            exported = source.exported()
            index = self._meshes[key] = None if exported is None else len(meshes)
            if exported is not None:
                meshes.append(exported)
        if index is not None:
            seen = self._attributes_seen.setdefault(key, set())
            added = source.attributes(each for each in asked if each not in seen and each[0] != STRAND_KIND)
            if added:
                meshes[index] = replace(meshes[index], attributes=(*meshes[index].attributes, *added))
            seen.update(asked)
        if edited:
            obj.to_mesh_clear()
        return index

    def _source(self, obj: _Object, data: bpy.types.Mesh, edited: bool) -> MeshSource | LiveSource:
        warnings = self.placements.warnings

        def read() -> MeshSource:
            return MeshSource(obj.to_mesh() if edited else data, obj.name, warnings)

        return read() if self._live is None else self._live.source(obj, data, read, warnings)

    def _volume(self, obj: _Object, key: tuple, asked: list[tuple[str, str]]) -> int | None:
        """Index of the box around a volume object, with the grids `asked`; None if there is nothing in it."""
        if (key := (*key, *asked)) not in self._meshes:
            frame = self.placements.materials.collections.frame
            names = dict.fromkeys(name for _, name in asked)
            made = export_volume(obj, names, frame, self.placements.warnings, self.blur)
            self._meshes[key] = None if made is None else len(self.placements.meshes)
            if made is not None:
                self.placements.meshes.append(made)
        return self._meshes[key]

    def _object_values(
        self, obj: _Object, parent: _Object | None, asked: list[tuple[str, str]]
    ) -> tuple[tuple[int, tuple[float, ...]], ...]:
        """Indices and values of the object's attributes `asked`."""
        values = []
        for kind, name in asked:
            value = object_value(obj, parent, kind, name)
            if value is None:
                self._lacking.setdefault(name, []).append(obj.name)
            else:
                values.append((self.placements.materials.collections.object_attribute(kind, name), value))
        return tuple(values)

    def materials_of(self, obj: _Object, data: bpy.types.ID) -> list[int]:
        """The materials of the object's slots."""
        slots = obj.material_slots
        wanted = []
        for i in range(slot_count(data)):
            material = slots[i].material if i < len(slots) else data.materials[i] if i < len(data.materials) else None
            material = self.material_override or material
            if material is None and (obj.type == "VOLUME" or smoke_domain(obj) is not None):
                wanted.append(self.placements.materials.volume_index())
                continue
            wanted.append(self.placements.materials.index(material, obj.name))
        return wanted

    def _visibility(self, obj: _Object) -> int:
        original = obj.original
        key = original.as_pointer()
        if key not in self._visibilities:
            seen = sum(bit for bit, is_seen in zip(_RAY_BITS, _seen_by_rays(obj), strict=True) if is_seen)
            if original.indirect_only_get(view_layer=self.view_layer):
                seen &= ~int(Visibility.CAMERA)
            self._visibilities[key] = seen
        return self._visibilities[key]

    def _name_index(self, obj: _Object) -> int:
        name = obj.name
        if name not in self._object_index:
            self._object_index[name] = len(self.placements.object_names)
            self.placements.object_names.append(name)
            asset = obj
            while asset.parent is not None:
                asset = asset.parent
            self.placements.asset_names.append(asset.name)
        return self._object_index[name]

    def _note_unsupported(self, obj: _Object, placed: _Placed) -> None:
        """Remember by name the parts of `obj` that are not rendered as they are."""
        if obj.type not in _SOLID_TYPES:
            return
        if any(getattr(each, "use_adaptive_subdivision", False) and each.show_render for each in obj.modifiers):
            self._note("adaptive subdivision (the modifier's levels for renders instead) is", obj.name)

    def _note(self, what: str, name: str) -> None:
        self._unsupported.setdefault(what, []).append(name)
