"""The sampling of a world, kept from frame to frame: computing how bright millions of texels are takes seconds, and few
worlds change.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...programs.op import op_named
from ...scene.description import Image, Scene
from ...shading.lights.world import SampledWorld, sampled_world
from .unchanged import pictures_of

# Ops of worlds that read where the camera is
_CAMERA_OPS = frozenset({"camera_coordinates", "window_coordinates", "vector_transform"})


@dataclass(frozen=True)
class _Kept:
    key: tuple
    pictures: tuple[
        weakref.ref | None, ...
    ]  # arrays of pixels, compared by identity: they are the same while an image is
    world: SampledWorld


class WorldCache:
    """The world of the last frame."""

    def __init__(self) -> None:
        self._last: _Kept | None = None

    @property
    def device_bytes(self) -> int:
        """Memory that it takes on the device [bytes]."""
        if self._last is None:
            return 0
        table = self._last.world.table
        return 4 * (table.row_first.size + table.texel_first.size)

    def clear(self) -> None:
        """Forget it."""
        self._last = None

    def get(self, scene: Scene, device: wp.Device, texels: Callable[[], np.ndarray]) -> SampledWorld:
        """The world of `scene`. `texels()` computes the brightness of its texels, and is called where this is not the
        world of the last call.
        """
        images = _images(scene)
        pictures = [pixels for image in images for pixels in pictures_of(image)]
        key = (
            *_key(scene, device),
            tuple((image.encoding, tuple(number for number, _ in image.tiles or ())) for image in images),
        )
        last = self._last
        same = (
            last is not None
            and last.key == key
            and len(last.pictures) == len(pictures)
            and all(map(_is, last.pictures, pictures))
        )
        if not same:
            self._last = last = None  # before there are two of them
            references = tuple(None if pixels is None else weakref.ref(pixels) for pixels in pictures)
            self._last = last = _Kept(key, references, sampled_world(texels(), device))
        return last.world


def _is(kept: weakref.ref | None, pixels: np.ndarray | None) -> bool:
    return pixels is None if kept is None else kept() is pixels and pixels is not None


def _key(scene: Scene, device: wp.Device) -> tuple:
    """All that the brightness of the world's texels follows from, but for images."""
    world = scene.world
    camera: tuple = ()
    if not _CAMERA_OPS.isdisjoint(world.program.ops):
        camera = (
            int(scene.camera.kind),
            np.asarray(scene.camera.transform, np.float64).tobytes(),
            tuple(scene.camera.window),
        )
    return (device.alias, world.program.instructions, world.program.constants.tobytes(), world.sampling_size, camera)


def _images(scene: Scene) -> tuple[Image, ...]:
    found = []
    for step in scene.world.program.instructions:
        found += [word for letter, word in zip(op_named(step.op).inputs, step.words) if letter == "m" and word >= 0]
    return tuple(scene.images[index] for index in dict.fromkeys(found))
