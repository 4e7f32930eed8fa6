"""Blender's materials as the core's `Material`s."""

from __future__ import annotations

import functools
from collections.abc import Hashable
from dataclasses import replace

import bpy

from ..core.programs.builder import Value
from ..core.programs.op import VOLUME_PREFIX
from ..core.scene.description import Closure, ClosureKind, Material
from ..core.scene.notice import Notice, Weight, as_notice
from .kept_materials import KeptMaterials, UntouchedMaterials, corrects_bump, emission_sampling, is_aimed_at
from .nodes.collections import Collections
from .nodes.compile import compile_displacement, compile_graph, compile_volume, default_volume
from .nodes.graph import find_source
from .nodes.shaders.principled import KINDS as PRINCIPLED_KINDS
from .nodes.shaders.principled import Layers, layered_closures
from .world import has_nodes

# Closures, and their kinds, of a surface that nobody sees
BOUNDARY = (Closure(ClosureKind.TRANSPARENT, (1.0, 1.0, 1.0)),), (ClosureKind.TRANSPARENT,)
_DEFAULT_GREY = (0.8, 0.8, 0.8)  # Blender's surface without a material
_HOLDOUT = "holdout"  # what the camera sees of holdout objects
_AIMED_AT_BOTH = "Emission Sampling of one side: rays are aimed at both sides of what emits; noise differs"
_BUMP_CORRECTED = "Bump Map Correction off is not supported: normals of bump and normal maps are corrected all the same"
# Most objects that a message about their material names
_NAMED_USERS = 3


class ExportedMaterials:
    """The materials of one scene, each exported once, in the order of their first use."""

    def __init__(self, collections: Collections | None = None) -> None:
        self.collections = collections or Collections()
        self.kept = KeptMaterials(self.collections)  # graphs of earlier exports
        self.materials: list[Material] = []
        # for each material: kind and name of the attributes that it reads
        self.asked: list[frozenset[tuple[str, str]]] = []
        self.compiled_count = 0  # materials that were looked at, and not known to be as before
        self._index: dict[Hashable, int] = {}
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

    def begin_live(self, untouched: UntouchedMaterials) -> None:
        """A pass of a viewport begins; `untouched`: materials that were not edited since its last one."""
        self.kept.untouched = untouched
        untouched.begin(self.collections)

    @property
    def reads_elsewhere(self) -> bool:
        """Whether a graph may read more than its nodes: places of objects, or animated values."""
        return self.kept.reads_elsewhere

    def forget_graphs(self) -> None:
        """Keep nothing of Blender's."""
        self.kept.forget_graphs()

    def end_live(self) -> None:
        """The pass is over."""
        assert self.kept.untouched is not None  # since `begin_live`
        self.kept.untouched.end(self.collections, self.kept.used)

    def holdout(self) -> int:
        """The index of a material that is a hole in the picture."""
        if _HOLDOUT not in self._index:
            self._index[_HOLDOUT] = len(self.materials)
            kinds = (ClosureKind.HOLDOUT,)
            self.materials.append(Material(_HOLDOUT, (Closure(ClosureKind.HOLDOUT, (1.0, 1.0, 1.0)),), kinds))
            self.asked.append(frozenset())
        return self._index[_HOLDOUT]

    def volume_index(self) -> int:
        """The index of Blender's default material of volume objects."""
        if VOLUME_PREFIX not in self._index:
            self._index[VOLUME_PREFIX] = len(self.materials)
            self.collections.begin()
            self.materials.append(Material("default volume", *BOUNDARY, volume=default_volume(self.collections)))
            self.asked.append(frozenset(self.collections.asked))
        return self._index[VOLUME_PREFIX]

    def _export(self, material: bpy.types.Material | None) -> tuple[Material, list[str]]:
        self.collections.begin()
        found = self.kept.find_untouched(material)
        if found is not None:
            return found
        self.collections.begin()
        self.compiled_count += 1
        signature = self.kept.signature(material)
        found = self.kept.find(material, signature) if signature is not None else None
        if found is None:
            self.collections.begin()
            exported, notes = export_material(material, self.collections)
            if material is not None:
                exported = replace(exported, index=material.pass_index, aimed=is_aimed_at(material))
            found = exported, notes
            self.kept.keep(material, signature, *found)
        return found

    def warnings(self) -> list[Notice]:
        """One line for each material that is not rendered as it is: its name, its nodes, its objects."""
        lines = []
        for index, notes in self._notes.items():
            users = self._users[index]
            named = ", ".join(f"“{name}”" for name in users[:_NAMED_USERS])
            more = f" and {len(users) - _NAMED_USERS} more" if len(users) > _NAMED_USERS else ""
            material = self.materials[index].name
            lines.append(
                Notice(
                    f"material “{material}” of {named}{more}: {'; '.join(notes)}",
                    max(as_notice(note).weight for note in notes),
                    objects=users,
                    material=material,
                    nodes=dict.fromkeys(node for note in notes for node in as_notice(note).nodes),
                    remedy="; ".join(dict.fromkeys(as_notice(note).remedy for note in notes if as_notice(note).remedy)),
                )
            )
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
        return _default_material(), []
    if not has_nodes(material):
        return Material(material.name, _viewport_closures(material), tuple(sorted(PRINCIPLED_KINDS))), []
    tree = material.node_tree
    output = collections.output(tree) or tree.get_output_node("CYCLES") or tree.get_output_node("EEVEE")
    if output is None:
        return Material(material.name), []
    linked = {name for name in ("Surface", "Volume", "Displacement") if find_source(output.inputs[name])[0] is not None}
    volume, volume_notes = compile_volume(output.inputs["Volume"], material, collections)
    notes = list(volume_notes)
    if "Volume" in linked and "Surface" not in linked:  # a volume alone has no surface
        return Material(material.name, *BOUNDARY, volume=volume), notes
    moves = "Displacement" in linked and material.displacement_method != "BUMP"
    bends = "Displacement" in linked and material.displacement_method != "DISPLACEMENT"
    compiled = compile_graph(output.inputs["Surface"], material, collections, bends)
    if emission_sampling(material) in ("FRONT", "BACK") and ClosureKind.EMISSION in compiled.kinds:
        notes.append(Notice(_AIMED_AT_BOTH, Weight.SETTING, remedy="set Emission Sampling to Front and Back, or None"))
    if ClosureKind.OWN_NORMAL in compiled.kinds and not corrects_bump(material):
        notes.append(Notice(_BUMP_CORRECTED, remedy="turn on Bump Map Correction in the material's settings of Cycles"))
    displacement = None
    if moves:
        moved = compile_displacement(output.inputs["Displacement"], material, collections)
        displacement = moved.program
        notes += [note for note in moved.notes if note not in compiled.notes]
    return Material(
        material.name,
        compiled.closures,
        compiled.kinds,
        compiled.program,
        displacement=displacement,
        displacement_bends=moves and bends,
        volume=volume,
        # as in Cycles, where what has a volume is looked at whatever the material says
        shadow_opaque=volume is None and not material.use_transparent_shadow,
    ), [*compiled.notes, *notes]


@functools.cache
def _default_material() -> Material:
    """What Cycles gives surfaces without a material: a Principled BSDF as Blender adds it; before 5.0 Lambert's."""
    if bpy.app.version < (5, 0):
        return Material("default", (Closure(ClosureKind.DIFFUSE, _DEFAULT_GREY),), (ClosureKind.DIFFUSE,))
    closures = layered_closures(Layers(Value.of(_DEFAULT_GREY), metallic=Value.of(0.0), roughness=Value.of(0.5)))
    return Material("default", closures, tuple(sorted({closure.kind for closure in closures})))


def _viewport_closures(material: bpy.types.Material) -> tuple[Closure, ...]:
    """Closures of a material without nodes."""
    red, green, blue = (float(c) for c in material.diffuse_color[:3])
    return layered_closures(
        Layers(Value.of((red, green, blue)), Value.of(material.metallic), Value.of(material.roughness))
    )
