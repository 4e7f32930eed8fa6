"""Data derived from a scene's frozen arrays, kept for the next render where it has the same ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np

from ...device.bulk import digest_of
from ...programs.inputs_data import CAMERA_OPS, INPUT_OPS, corner_arrays
from ...programs.op import op_named
from ...scene.description import Image, Mesh, Scene
from ...scene.features import scene_volumes
from ...scene.flatten import IDENTITY, is_mirrored_where_baked
from ...scene.frozen import Same, is_frozen
from ...scene.motion import deforming_meshes
from ...scene.program import Program
from ...shading.volumes.grids import grid_digest

Made = TypeVar("Made")


# Things up to this size are kept beside one another, and so many of them in all: view layers of a frame take turns
_SMALL, _KEPT_MOST = 1 << 20, 12  # [bytes]


class LastSmall(Generic[Made]):
    """The last things that were made of arrays and values: several small ones, or a large one."""

    def __init__(self, size: Callable[[Made], int]) -> None:
        """`size`: memory that a thing takes [bytes]."""
        self._size, self._kept = size, list[tuple[Same, Made]]()  # the one that was used last comes last

    def get(self, key: tuple[list[np.ndarray | None], object], make: Callable[[], Made]) -> Made:
        """What `make()` returns, which is called unless `key` has the values and frozen arrays of an earlier call."""
        found = next((each for each in reversed(self._kept) if each[0].holds(*key)), None)
        if found is None:
            self.drop_large()  # before there are two of them
            found = Same(*key), make()
        else:
            self._kept.remove(found)
        self._kept = [*self._kept[1 - _KEPT_MOST :], found]
        return found[1]

    @property
    def bytes(self) -> int:
        """Memory that all of them take [bytes]."""
        return sum(self._size(each[1]) for each in self._kept)

    def drop_large(self) -> None:
        """Forget what is large."""
        self._kept = [each for each in self._kept if self._size(each[1]) <= _SMALL]

    def clear(self) -> None:
        """Forget all."""
        self._kept = []


class Last(Generic[Made]):
    """The last thing that was made of arrays and values."""

    def __init__(self) -> None:
        self.made: Made | None = None
        self._same: Same | None = None

    def get(self, key: tuple[list[np.ndarray | None], object], make: Callable[[], Made]) -> Made:
        """What `make()` returns, which is called unless `key` has the values and frozen arrays of the last call."""
        if self._same is None or not self._same.holds(*key):
            self.clear()  # before there are two of them
            self.made = make()
            self._same = Same(*key)
        return self.made

    def clear(self) -> None:
        """Forget it."""
        self.made = self._same = None


def inputs_key(
    scene: Scene, ops: Sequence[str], device: str, places: Sequence[np.ndarray] | None = None
) -> tuple[list[np.ndarray | None], tuple]:
    """What the inputs of programs with `ops` follow from (`upload_inputs`), but for the camera: arrays and values.

    `places`: what counts of where instances are (default: all of it).
    """
    arrays = [array for mesh in scene.meshes for array in arrays_read(mesh, ops)]
    instances = scene.instances
    placed = [instances.mesh, instances.slot_first, scene.slot_materials]
    placed += [instances.transform] if places is None else places
    placed += [each for each in (instances.info, instances.attributes) if each is not None]
    values = (
        device,
        tuple(ops),
        digest_of(placed),
        (instances.info is None, instances.attributes is None),
        tuple((mesh.texture_space, tuple((each.kind, each.name) for each in mesh.attributes)) for mesh in scene.meshes),
        tuple(scene.attributes),
        tuple(
            material.program is not None and any(step.op == "generated" for step in material.program.instructions)
            for material in scene.materials
        ),
    )
    return arrays, values


def arrays_read(mesh: Mesh, ops: Iterable[str]) -> list[np.ndarray | None]:
    """What programs with `ops` read of a mesh."""
    return [mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.base_positions, *corner_arrays(mesh, ops)]


def kept_inputs_key(scene: Scene, ops: Sequence[str], device: str) -> tuple[list[np.ndarray | None], tuple]:
    """The same, but for maps between the spaces of objects and the world, which follow from places alone, and for ops
    that read nothing of the inputs: a node that comes into a graph or goes has nothing uploaded again.
    """
    places = [is_mirrored_where_baked(scene)]
    if "generated" in ops:
        places.append((np.asarray(scene.instances.transform) != IDENTITY).any((1, 2)))
        places.append(deforming_meshes(scene))
    return inputs_key(scene, [op for op in ops if op in INPUT_OPS], device, places)


def _motion(scene: Scene) -> list[np.ndarray]:
    """Where instances of `scene` are at other times."""
    motion = scene.instances.motion
    return [] if motion is None else [motion.instance, motion.maps]


def camera_key(scene: Scene, programs: Iterable[Program | None]) -> tuple:
    """All that `programs` may read of camera and frame; nothing where they read nothing of them."""
    if not any(program and not CAMERA_OPS.isdisjoint(program.ops) for program in programs):
        return ()
    camera, frame = scene.camera, scene.frame
    matrix = np.asarray(camera.transform, np.float64).tobytes()
    return (int(camera.kind), matrix, tuple(camera.window), camera.panorama, frame.width, frame.height)


def bounds_key(
    scene: Scene, volume_of: np.ndarray, ops: Sequence[str], device: str
) -> tuple[list[np.ndarray | None], tuple]:
    """What the bounds of volumes with programs follow from, but for the box that the world's is taken to fill: arrays
    and values. `volume_of`: the volume of each material, or -1. Arrays that may change count by their numbers.
    """
    arrays, values = inputs_key(scene, ops, device)
    arrays += [mesh.motion for mesh in scene.meshes]
    volumes = scene_volumes(scene)
    programs = [volume.program for volume in volumes]
    images = images_of(scene, programs)
    arrays += [pixels for image in images for pixels in pictures_of(image)]
    kinds = tuple((int(image.encoding), tuple(number for number, _ in image.tiles or ())) for image in images)
    made = tuple(program and (program.instructions, program.constants.tobytes()) for program in programs)
    grids = [
        (
            mesh.object_density,
            tuple((grid.name, grid_digest(grid)) for grid in mesh.grids),
            mesh.flow and (grid_digest(mesh.flow), mesh.flow_time),
        )
        for mesh in scene.meshes
    ]
    numbers = [grid.to_index for mesh in scene.meshes for grid in mesh.grids]
    numbers += [array for array in arrays if array is not None and not is_frozen(array)]
    kept = [None if array is None or not is_frozen(array) else array for array in arrays]
    seen = camera_key(scene, programs)
    return kept, (values, kinds, made, seen, tuple(grids), digest_of([volume_of, *numbers, *_motion(scene)]))


def images_of(scene: Scene, programs: Iterable[Program | None]) -> tuple[Image, ...]:
    """The images that `programs` look up."""
    found = []
    for program in programs:
        for step in program.instructions if program else ():
            found += [word for letter, word in zip(op_named(step.op).inputs, step.words) if letter == "m"]
    # what is none of them is shown as a missing one
    return tuple(scene.images[index] for index in dict.fromkeys(found) if 0 <= index < len(scene.images))


def pictures_of(image: Image) -> list[np.ndarray | None]:
    """The pixels of `image`, or of each of its tiles."""
    return [image.pixels] if image.tiles is None else [pixels for _, pixels in image.tiles]
