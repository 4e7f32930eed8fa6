"""Meshes of strands and points among those of a scene: each made once, with the attributes that materials ask for."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Protocol, TypeAlias

import bpy

from ...core.scene.description import Attribute, Mesh
from ...core.scene.notice import Notice, Weight
from ..meshes.attributes import lacking_attribute
from ..meshes.placements import Placements
from .sources import STRAND_KIND, CurvesSource, ParticleHair, PointsSource, Source
from .strands import curve_shape

_Asked = list[tuple[str, str]]
CurveData: TypeAlias = bpy.types.Curves | bpy.types.PointCloud | bpy.types.ParticleSystemModifier


class MaterialCollector(Protocol):
    """The pass over a depsgraph, as far as strands and points ask it."""

    placements: Placements
    viewport: bool
    material_override: bpy.types.Material | None

    def materials_of(self, obj: bpy.types.Object, data: CurveData) -> list[int]:
        """The materials of the object's slots."""


class StrandMeshes:
    """The strands and points of an export."""

    def __init__(self, meshes: list[Mesh], warnings: list[str], scene: bpy.types.Scene) -> None:
        """New meshes go to `meshes`, messages to `warnings`."""
        self._meshes, self._warnings = meshes, warnings
        self._shape = curve_shape(scene)
        self._made: dict[Hashable, tuple[Source, int | None]] = {}
        self.sources: dict[int, Source] = {}  # by mesh
        self._seen: dict[Hashable, set[tuple[str, str]]] = {}

    def forget_sources(self) -> None:
        """Keep nothing of Blender's: what is asked for again is made again."""
        self.sources.clear()
        self._made.clear()
        self._seen.clear()

    def of(
        self, obj: bpy.types.Object, data: CurveData, collector: MaterialCollector
    ) -> tuple[list[int], Callable[[_Asked], int | None]]:
        """Materials of the slots of `data` (curves, points, or the modifier of a particle system) of `obj`, and the
        function that makes its mesh, with attributes.
        """
        placements = collector.placements
        if isinstance(data, (bpy.types.Curves, bpy.types.PointCloud)):
            wanted = collector.materials_of(obj, data)
        else:
            slots = obj.material_slots
            slot = min(data.particle_system.settings.material, len(slots)) - 1
            material = slots[slot].material if slot >= 0 else None
            wanted = [placements.materials.index(collector.material_override or material, obj.name)]
        programs = [placements.materials.materials[index].program for index in wanted]
        reads_uv = any(
            program is not None and any(each.op in ("uv", "uv_tangent") for each in program.instructions)
            for program in programs
        )
        return wanted, lambda asked: self._mesh(obj, data, asked, reads_uv, collector.viewport)

    def _mesh(
        self, obj: bpy.types.Object, data: CurveData, asked: _Asked, reads_uv: bool, viewport: bool
    ) -> int | None:
        key = (data.as_pointer(), reads_uv)
        if key not in self._made:
            source = self._source(obj, data, viewport)
            mesh = source.exported(reads_uv, self._warnings)
            self._made[key] = source, None if mesh is None else len(self._meshes)
            if mesh is not None:
                self.sources[len(self._meshes)] = source
                self._meshes.append(mesh)
        source, index = self._made[key]
        if index is not None:
            seen = self._seen.setdefault(key, set())
            new = [each for each in asked if each not in seen]
            added = source.attributes(new, obj.name, self._warnings)
            self._report_lacking(obj, new, added)
            mesh = self._meshes[index]
            self._meshes[index] = replace(mesh, attributes=(*mesh.attributes, *added))
            seen.update(asked)
        return index

    def _report_lacking(self, obj: bpy.types.Object, asked: _Asked, added: list[Attribute]) -> None:
        there = {(each.kind, each.name) for each in added}
        for kind, name in asked:
            if (kind, name) not in there and kind not in (STRAND_KIND, "GRID"):
                what = lacking_attribute(kind, name)
                text = f"object “{obj.name}”: its strands or points have no {what}, which their material asks for"
                self._warnings.append(Notice(text, Weight.REPLACED, objects=[obj.name]))

    def _source(self, obj: bpy.types.Object, data: CurveData, viewport: bool) -> Source:
        if isinstance(data, bpy.types.Curves):
            return CurvesSource(data, obj.name, self._shape)
        if isinstance(data, bpy.types.PointCloud):
            return PointsSource(data, obj.name)
        return ParticleHair(obj, data, self._shape, viewport)
