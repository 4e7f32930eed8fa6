"""A scene whose meshes are displaced: each once for all instances that displace it alike."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..device.bulk import kinds_of
from ..scene.description import Instances, Material, Mesh, Scene
from ..scene.frozen import Same
from ..scene.notice import Notice, Weight
from ..scene.validate import COORDINATE_MAX
from ..shading.images.textures import ImageTable
from .evaluate import Move, move_vertices, offsets_of
from .vertices import MovedVertices, moved_mesh, used_meshes


def is_displaced(scene: Scene) -> bool:
    """Whether any material moves vertices."""
    return any(material.displacement is not None for material in scene.materials)


@dataclass
class _Kept:
    """A mesh that was displaced, and what of the scene it was made of."""

    mesh: Mesh
    warnings: tuple[str, ...]
    same: Same
    programs: tuple  # kept alive, since `same` knows them by their identity


class DisplacedMeshes:
    """Meshes of the last scene, for the next one: kept where arrays, programs and transform are the same."""

    def __init__(self) -> None:
        self._kept: list[_Kept] = []

    def clear(self) -> None:
        """Forget them."""
        self._kept = []

    def displaced(
        self, scene: Scene, images: Callable[[], ImageTable], device: wp.Device, move: Move = move_vertices
    ) -> Scene:
        """`scene` with its vertices moved by the displacement of their materials, evaluated on `device`.

        An instance of a mesh is displaced as the first one is that has displacement of the same materials: in its
        transform, as in Cycles. Instances of other materials get a mesh of their own. A displacement that is not finite
        leaves its vertex where it is, and a warning names the object. `images` is called if there is anything to do,
        and `move` runs the programs.
        """
        if not is_displaced(scene):
            self.clear()
            return scene
        instances, meshes, warnings = scene.instances, list(scene.meshes), list(scene.warnings)
        # of all instances of a mesh with the same slots one is looked at
        first, kind = kinds_of(instances.mesh.astype(np.int64) << 32 | instances.slot_first)
        chosen, kept = np.array(instances.mesh[first], np.int32), []
        done: dict[tuple, int] = {}
        for place, i in enumerate(first.tolist()):
            index = int(instances.mesh[i])
            mesh = scene.meshes[index]
            materials = _materials_of(scene, mesh, i)
            if (
                len(mesh.triangles) == 0
                or mesh.radii is not None
                or all(material.displacement is None for material in materials)
            ):
                continue
            key = (index, *((id(each.displacement), each.displacement_bends) for each in materials))
            if key not in done:
                found = self._mesh(scene, i, materials, images, device, move)
                kept.append(found)
                warnings += found.warnings
                done[key] = len(meshes)
                meshes.append(found.mesh)
            chosen[place] = done[key]
        self._kept = kept
        meshes, mesh_of = used_meshes(meshes, chosen[kind])
        return dataclasses.replace(
            scene,
            meshes=tuple(meshes),
            instances=dataclasses.replace(instances, mesh=mesh_of),
            warnings=tuple(dict.fromkeys(warnings)),
        )

    def _mesh(
        self,
        scene: Scene,
        i: int,
        materials: list[Material],
        images: Callable[[], ImageTable],
        device: wp.Device,
        move: Move,
    ) -> _Kept:
        """The mesh of instance `i`, displaced."""
        mesh = scene.meshes[scene.instances.mesh[i]]
        programs = tuple(material.displacement for material in materials)
        arrays = [mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs]
        arrays += [mesh.motion, mesh.motion_normals, *(attribute.values for attribute in mesh.attributes)]
        arrays += [pixels for each in scene.images for pixels in (each.pixels, *(p for _, p in each.tiles or ()))]
        info, own = scene.instances.info, scene.instances.attributes
        values = (
            device.alias,
            tuple(id(each) for each in programs),
            tuple(material.displacement_bends for material in materials),
            np.asarray(scene.instances.transform[i]).tobytes(),
            mesh.texture_space,
            scene.attributes,
            None if info is None else info[i].tobytes(),
            None if own is None else own[i].tobytes(),
        )
        for each in self._kept:
            if each.same.holds(arrays, values):
                return each
        part = _alone(scene, i)
        slots = np.zeros(len(mesh.triangles), np.int32) if mesh.triangle_slot is None else mesh.triangle_slot
        moves = np.array([each.displacement is not None for each in materials])[slots]
        bends = np.array([each.displacement_bends for each in materials])[slots]
        moved = MovedVertices.of(mesh, moves)
        offset = offsets_of(part, moved, images(), device, move)
        finite = _is_usable(offset, part, moved)
        warnings = ()
        if not finite.all():
            names = {materials[slots[triangle]].name for triangle in moved.triangle[~finite]}
            named = ", ".join(f"“{name}”" for name in sorted(names))
            name = scene.object_names[scene.instances.object[i]]
            text = (
                f"object “{name}”: the displacement of {named} is not finite, or too large, at "
                f"{int((~finite).sum()):,} vertices, which stay where they are"
            )
            warnings = (Notice(text, Weight.REPAIRED, objects=[name]),)
            offset[~finite] = 0
        displaced = moved_mesh(mesh, moved, offset, moves & ~bends)
        return _Kept(displaced, warnings, Same(arrays, values), programs)


def _materials_of(scene: Scene, mesh: Mesh, i: int) -> list[Material]:
    """Materials of the slots of `mesh`, as instance `i` has them."""
    slots = 1 if mesh.triangle_slot is None or len(mesh.triangles) == 0 else int(mesh.triangle_slot.max()) + 1
    first = int(scene.instances.slot_first[i])
    return [scene.materials[index] for index in scene.slot_materials[first : first + slots].tolist()]


def _is_usable(offset: np.ndarray, part: Scene, moved: MovedVertices) -> np.ndarray:
    """Whether vertices moved by `offset` can be rendered, in object space and in the world; bool, shape [n]."""
    matrix = np.asarray(part.instances.transform[0], np.float64)
    there = part.meshes[0].positions[moved.vertex] + offset
    world = there @ matrix[:, :3].T + matrix[:, 3]
    with np.errstate(invalid="ignore"):
        return (np.abs(np.concatenate([there, world], axis=1)) <= COORDINATE_MAX).all(axis=1)


def _alone(scene: Scene, i: int) -> Scene:
    """Instance `i` and its mesh alone."""
    instances = scene.instances
    still = dataclasses.replace(instances, motion=None, frames=None)  # displaced as it is, however it moves
    rows = {field.name: getattr(still, field.name) for field in dataclasses.fields(Instances)}
    row = Instances(**{name: None if values is None else values[i : i + 1] for name, values in rows.items()})
    mesh = scene.meshes[instances.mesh[i]]
    return dataclasses.replace(
        scene, meshes=(mesh,), instances=dataclasses.replace(row, mesh=np.zeros(1, np.int32)), lights=()
    )
