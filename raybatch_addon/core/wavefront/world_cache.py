"""The sampling of a world, kept from frame to frame: to tell how bright millions of texels are takes seconds, and few worlds change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..scene.description import Image, Scene
from ..shading.nodes.op import op_named
from ..shading.world import SampledWorld, sampled_world

# Ops of worlds that read where the camera is
_CAMERA_OPS = frozenset({"camera_coordinates", "window_coordinates", "vector_transform"})


@dataclass(frozen=True)
class _Kept:
    key: tuple
    images: tuple[Image, ...]  # compared by identity: the exporter hands out the same one while it is the same
    world: SampledWorld


class WorldCache:
    """The world of the last frame."""

    def __init__(self) -> None:
        self._last: _Kept | None = None

    def clear(self) -> None:
        """Forget it."""
        self._last = None

    def get(self, scene: Scene, device: wp.Device, texels: Callable[[], np.ndarray]) -> SampledWorld:
        """The world of `scene`; `texels()` tells how bright they are, where this is not the world of the last call."""
        key, images = _key(scene, device), _images(scene)
        last = self._last
        same = last is not None and last.key == key and len(last.images) == len(images) and all(map(_is, last.images, images))
        if not same:
            last = self._last = _Kept(key, images, sampled_world(texels(), device))
        return last.world


def _is(a: Image, b: Image) -> bool:
    return a is b


def _key(scene: Scene, device: wp.Device) -> tuple:
    """All that the brightness of the world's texels follows from, but for images."""
    world = scene.world
    camera: tuple = ()
    if not _CAMERA_OPS.isdisjoint(world.program.ops):
        camera = (int(scene.camera.kind), np.asarray(scene.camera.transform, np.float64).tobytes(), tuple(scene.camera.window))
    return (device.alias, world.program.instructions, world.program.constants.tobytes(), world.sampling_size, camera)


def _images(scene: Scene) -> tuple[Image, ...]:
    found = []
    for step in scene.world.program.instructions:
        found += [word for letter, word in zip(op_named(step.op).inputs, step.words) if letter == "m" and word >= 0]
    return tuple(scene.images[index] for index in dict.fromkeys(found))
