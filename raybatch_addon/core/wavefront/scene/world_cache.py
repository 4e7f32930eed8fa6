"""The sampling of a world, kept from frame to frame: computing how bright millions of texels are takes seconds, and few
worlds change.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ...programs.op import op_named
from ...scene.description import Image, Scene
from ...shading.lights.world import SampledWorld, sampled_world
from .unchanged import Last, camera_key, pictures_of


class WorldCache:
    """The world of the last frame."""

    def __init__(self) -> None:
        self._last: Last[SampledWorld] = Last()

    @property
    def device_bytes(self) -> int:
        """Memory that it takes on the device [bytes]."""
        world = self._last.made
        return 4 * (world.table.row_first.size + world.table.texel_first.size) if world else 0

    def clear(self) -> None:
        """Forget it."""
        self._last.clear()

    def get(self, scene: Scene, device: wp.Device, texels: Callable[[], np.ndarray]) -> SampledWorld:
        """The world of `scene`. `texels()` computes the brightness of its texels, and is called unless this is the
        world of the last call, with the same frozen images.
        """
        return self._last.get(_key(scene, device), lambda: sampled_world(texels(), device))


def _key(scene: Scene, device: wp.Device) -> tuple[list[np.ndarray | None], tuple]:
    """What the brightness of the world's texels follows from: pixels and values."""
    world = scene.world
    images = _images(scene)
    kinds = tuple((int(image.encoding), tuple(number for number, _ in image.tiles or ())) for image in images)
    program = (world.program.instructions, world.program.constants.tobytes())
    pixels = [each for image in images for each in pictures_of(image)]
    return pixels, (device.alias, program, world.sampling_size, camera_key(scene, [world.program]), kinds)


def _images(scene: Scene) -> tuple[Image, ...]:
    found = []
    for step in scene.world.program.instructions:
        found += [word for letter, word in zip(op_named(step.op).inputs, step.words) if letter == "m" and word >= 0]
    return tuple(scene.images[index] for index in dict.fromkeys(found))
