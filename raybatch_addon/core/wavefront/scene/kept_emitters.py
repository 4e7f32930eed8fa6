"""Emissive triangles, kept for the next render where the same things shine alike: whatever else of the scene is shown,
hidden, edited or numbered anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...device.bulk import digest_of
from ...scene.description import Material, Scene
from ...scene.frozen import fact
from ...scene.motion import apart
from ...shading.lights.emitters import EmissiveTriangles
from .unchanged import LastSmall, arrays_read, camera_key, images_of, pictures_of


@dataclass(frozen=True)
class _Found:
    """Emissive triangles, and the instances that had materials which emit, ascending."""

    triangles: EmissiveTriangles
    shining: np.ndarray


class KeptEmitters:
    """The emissive triangles of the last scenes."""

    def __init__(self) -> None:
        self._last: LastSmall[_Found] = LastSmall(lambda found: found.triangles.bytes)

    def get(
        self, scene: Scene, emits: Sequence[bool], device: str, find: Callable[[], EmissiveTriangles]
    ) -> EmissiveTriangles:
        """Those of `scene`, by the numbers that its instances have: found by `find()`, or before in a scene in which
        the same things shine. `emits`: whether each material may emit.
        """
        if not any(emits):
            self._last.drop_large()
            return find()
        shining = _shining(scene, emits)
        found = self._last.get(_emission_key(scene, emits, shining, device), lambda: _Found(find(), shining))
        return _numbered(found, shining, len(scene.instances))

    def clear(self) -> None:
        """Forget them."""
        self._last.clear()


def _numbered(found: _Found, shining: np.ndarray, instance_count: int) -> EmissiveTriangles:
    """What was found, with other numbers of the instances that shine; these are as many, in the same order."""
    triangles = found.triangles
    if len(triangles.instance_first) == instance_count + 1 and np.array_equal(found.shining, shining):
        return triangles
    rank = np.searchsorted(found.shining, triangles.instance)
    instance = shining[rank].astype(np.int32)
    first = np.searchsorted(instance, np.arange(instance_count + 1)).astype(np.int32)
    return replace(triangles, instance=instance, instance_first=first)


def _slot_counts(scene: Scene) -> np.ndarray:
    """Material slots that the triangles of each mesh use, int64, shape [mesh_count]."""
    slots = [1 if mesh.triangle_slot is None else fact(mesh.triangle_slot, _slot_count) for mesh in scene.meshes]
    return np.array(slots, np.int64)


def _slot_count(slots: np.ndarray) -> int:
    return int(slots.max(initial=-1)) + 1


def _shining(scene: Scene, emits: Sequence[bool]) -> np.ndarray:
    """The instances with a material that may emit, ascending."""
    # number of emitting materials before each slot
    before = np.concatenate([[0], np.cumsum(np.asarray(emits, bool)[scene.slot_materials])])
    instances = scene.instances
    end = np.minimum(instances.slot_first + _slot_counts(scene)[instances.mesh], len(before) - 1)
    return np.flatnonzero(before[end] > before[instances.slot_first])


def _emission_key(
    scene: Scene, emits: Sequence[bool], shining: np.ndarray, device: str
) -> tuple[list[np.ndarray | None], tuple]:
    """What the emissive triangles follow from, but for the numbers of instances, meshes and materials: arrays and
    values. Of all that does not shine nothing counts.
    """
    instances = scene.instances
    emitting = [material for material, emits_light in zip(scene.materials, emits) if emits_light]
    programs = [material.program for material in emitting if material.program]
    ops = sorted({op for program in programs for op in program.ops})
    meshes, mesh = np.unique(instances.mesh[shining], return_inverse=True)
    arrays: list[np.ndarray | None] = []
    for index in meshes.tolist():
        arrays += [*arrays_read(scene.meshes[index], ops), scene.meshes[index].corner_normals]
    images = images_of(scene, programs)
    arrays += [pixels for image in images for pixels in pictures_of(image)]
    uses = np.bincount(instances.mesh, minlength=len(scene.meshes))
    places = [
        mesh,
        uses[instances.mesh[shining]] == 1,  # in world space: points are rounded otherwise there
        *_materials_of(scene, emits, shining),
        instances.transform[shining],
        instances.visibility[shining],
        apart(scene)[shining],
        *(each[shining] for each in (instances.info, instances.attributes) if each is not None),
    ]
    shapes = tuple(
        (scene.meshes[i].texture_space, tuple((each.kind, each.name) for each in scene.meshes[i].attributes))
        for i in meshes.tolist()
    )
    kinds = tuple((int(image.encoding), tuple(number for number, _ in image.tiles or ())) for image in images)
    values = (
        device,
        digest_of(places),
        (instances.info is None, instances.attributes is None),
        shapes,
        tuple(scene.attributes),
        kinds,
        tuple(map(_light_of, emitting)),
        camera_key(scene, programs),
    )
    return arrays, values


def _materials_of(scene: Scene, emits: Sequence[bool], shining: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The emitting materials of each slot of the instances that shine, counted among these (-1: another one), slots of
    one behind those before; and how many slots each instance has.
    """
    counts = _slot_counts(scene)[scene.instances.mesh[shining]]
    number = np.where(emits, np.cumsum(emits) - 1, -1)
    slot = np.repeat(scene.instances.slot_first[shining] - (np.cumsum(counts) - counts), counts)
    slot += np.arange(len(slot))
    return number[scene.slot_materials[np.minimum(slot, len(scene.slot_materials) - 1)]], counts


def _light_of(material: Material) -> tuple:
    program = material.program
    return (material.closures, program and (program.instructions, program.constants.tobytes()))
