"""Meshes and their placements in a scene, as they are collected, and which placements can be rendered."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.scene.description import Instances, Light, Mesh
from ...core.scene.notice import Notice, Weight
from ..curves.sources import Source
from ..light_links import ObjectLinks
from ..materials import ExportedMaterials
from ..motion.placed import PlacedMotion

if TYPE_CHECKING:
    import bpy
    import mathutils

# A matrix composed in float32 from a few products has elements wrong by about this much, relatively
_MATRIX_ERROR = 8 * 2.0**-24
# Why what has no inverse is left out
FLATTENED = (
    "it is flattened to nothing (its matrix is singular); give it, and what it is parented to, a scale that is not 0"
)


@dataclass(frozen=True, kw_only=True)
class Template:
    """Data that all placements of one mesh by one object share."""

    mesh: int
    slot_first: int
    visibility: int
    object: int
    # index and value of each attribute of the object that materials read
    attributes: tuple[tuple[int, tuple[float, ...]], ...] = ()
    # index and name of the attributes that they read of the surface that places each instance
    of_instancer: tuple[tuple[int, str], ...] = ()
    links: ObjectLinks = ObjectLinks()
    light_group: int = -1  # as in `Instances.light_group`
    terminator: float = 0.0  # as in `Instances.terminator`


@dataclass(kw_only=True)
class Placements:
    """Everything in the depsgraph that can be placed, collected in one pass."""

    meshes: list[Mesh] = field(default_factory=list)
    materials: ExportedMaterials = field(default_factory=ExportedMaterials)
    slot_materials: list[int] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    portals: list[Light] = field(default_factory=list)  # of the world
    object_names: list[str] = field(default_factory=list)
    asset_names: list[str] = field(default_factory=list)  # as in `Scene.asset_names`
    warnings: list[str] = field(default_factory=list)
    motion: list[PlacedMotion] = field(default_factory=list)  # of all placements; none where motion is not asked for
    strands: dict[int, Source] = field(default_factory=dict)  # what meshes of curves and points were made of, by mesh
    matrices: array = field(default_factory=lambda: array("f"))  # of all placements, 16 numbers each, row by row
    usable: np.ndarray | None = None  # which of them are instances: bool, once `instances` was called
    templates: list[Template] = field(default_factory=list)
    originals: list[bpy.types.Object] = field(default_factory=list)  # objects of all placements and lights
    linked: bool = False  # light is linked to receivers or blockers
    catches: bool = False  # some objects are shadow catchers
    grouped: bool = False  # emitters are in groups
    info: list[tuple[float, ...]] = field(default_factory=list)  # rows of `Instances.info`
    # instance, index and value of attributes
    of_instancer: list[tuple[int, int, tuple[float, ...]]] = field(default_factory=list)

    def instances(self, with_info: bool = False, moves: bool = False) -> Instances:
        """The placements whose matrix can be used; the others are named in `warnings`. `with_info`: with values of
        their objects (`Instances.info`) whether programs read them or not. `moves`: what is flat now may be so for a
        moment, and is among them.
        """
        count = len(self.templates)
        if count == 0:
            return Instances.empty()
        transform = self.map_rows().reshape(count, 4, 4)[:, :3]
        table = np.array([(t.mesh, t.slot_first, t.visibility, t.object) for t in self.templates], np.int32)
        usable = np.ones(count, bool)
        finite = np.isfinite(transform).all(axis=(1, 2))
        singular = finite & is_singular(np.where(finite[:, None, None], transform, 0))
        if moves:
            singular &= np.array([each.steps == 0 for each in self.motion], bool)
        for bad, reason in (
            (~finite, "its matrix is not finite; reset its location, rotation and scale"),
            (singular, FLATTENED),
        ):
            usable &= ~bad
            self.warnings += left_out_objects([self.object_names[index] for index in table[bad, 3].tolist()], reason)
        self.usable = usable
        mesh, slot_first, visibility, owner = np.ascontiguousarray(table[usable].T)
        programs = [p for m in self.materials.materials for p in (m.program, m.displacement) if p is not None]
        asked = with_info or any("object_info" in program.ops for program in programs)
        info = np.array(self.info, np.float32).reshape(count, 6)[usable] if asked else None
        links = groups = None
        if self.linked:
            sets = [(each.links.receiver, each.links.lights, each.links.shadows) for each in self.templates]
            links = np.array(sets, np.uint64)[usable]
        if self.grouped:
            groups = np.array([each.light_group for each in self.templates], np.int32)[usable]
        smooth = [each.corner_normals is not None for each in self.meshes]
        cutoffs = np.array([each.terminator * smooth[each.mesh] for each in self.templates], np.float32)[usable]
        return Instances(
            mesh,
            np.ascontiguousarray(transform[usable]),
            slot_first,
            visibility,
            owner,
            info=info,
            attributes=self._attributes(usable),
            links=links,
            light_group=groups,
            terminator=cutoffs if cutoffs.any() else None,
        )

    def with_attributes(self, light: Light, values: tuple[tuple[int, tuple[float, ...]], ...]) -> Light:
        """`light` with the values of its object's attributes, by their indices among all."""
        if not values:
            return light
        attributes = np.zeros((len(self.materials.collections.object_attributes), 4), np.float32)
        for index, value in values:
            attributes[index] = value
        return replace(light, attributes=attributes)

    def map_rows(self) -> np.ndarray:
        """Object to world of all placements, row by row: float32, shape [n, 16]."""
        return np.array(self.matrices, np.float32).reshape(-1, 16)

    def _attributes(self, usable: np.ndarray) -> np.ndarray | None:
        """The array of `Instances.attributes`."""
        asked = len(self.materials.collections.object_attributes)
        if not asked:
            return None
        values = np.zeros((len(self.templates), asked, 4), np.float32)
        for i, template in enumerate(self.templates):
            for index, value in template.attributes:
                values[i, index] = value
        for i, index, value in self.of_instancer:
            values[i, index] = value
        return values[usable]


def left_out_objects(names: Iterable[str], reason: str) -> list[Notice]:
    """That objects are left out: `names` of all their instances."""
    notices = []
    for name, times in sorted(Counter(names).items()):
        how_often = f" ({times:,} instances)" if times > 1 else ""
        text = f"object “{name}”{how_often} is left out: {reason}"
        notices.append(Notice(text, Weight.REPAIRED, objects=[name]))
    return notices


def row_bytes(matrix: mathutils.Matrix) -> bytes:
    """The numbers of `matrix`, row by row: float32."""
    try:
        return memoryview(matrix).tobytes()
    except TypeError:  # Blender before 5.1 gives no view of them
        return np.array(matrix, np.float32).tobytes()


def is_singular(transform: np.ndarray) -> np.ndarray:
    """Whether matrices [n, 3 or more, 4] collapse space, as far as float32 can show: bool, shape [n].

    The determinant is at most the product of the columns' lengths (Hadamard), and known to within the error of the
    elements relative to that product.
    """
    linear = transform[:, :3, :3].astype(np.float64)
    return np.abs(np.linalg.det(linear)) <= _MATRIX_ERROR * np.linalg.norm(linear, axis=1).prod(axis=1)
