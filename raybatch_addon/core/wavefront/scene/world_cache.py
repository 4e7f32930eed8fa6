"""The sampling of a world, kept from frame to frame: computing how bright millions of texels are takes seconds, and few
worlds change.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ...programs.parts import outputs_read
from ...scene.description import SCATTERED_RAYS, Scene, World
from ...scene.features import PATH_HISTORY_OPS
from ...shading.lights.world import SampledWorld, WorldLight, is_even, sampled_world
from .unchanged import Last, camera_key, images_of, pictures_of

_IS_CAMERA_RAY = 0  # output of the op `light_path`; of scattered rays none is one


class WorldCache:
    """The world of the last frame."""

    def __init__(self) -> None:
        self._last: Last[SampledWorld | None] = Last()

    @property
    def device_bytes(self) -> int:
        """Memory that it takes on the device [bytes]."""
        world = self._last.made
        return 4 * world.table.first.size if world else 0

    def clear(self) -> None:
        """Forget it."""
        self._last.clear()

    def get(
        self, scene: Scene, device: wp.Device, light_of: Callable[[], WorldLight], beside_rays: bool
    ) -> SampledWorld | None:
        """The world of `scene`; None for one that is the same everywhere and has no portals, which is not sampled,
        unless what is aimed at differs from what scattered rays meet: then both have the shares that they have in
        Cycles.
        `light_of()` computes its brightness, and is called unless this is the world of the last call, with the same
        frozen images. `beside_rays`: nearly each point from which light is aimed at sends a ray that may find the world
        too, and both are weighed against each other.
        """
        varies, has_portals = _may_vary(scene.world), bool(scene.world.portals)
        in_part = not scene.world.casts_shadow or scene.world.bounce_max is not None

        def made() -> SampledWorld | None:
            light = light_of()
            if varies or not is_even(light):
                beside = beside_rays and not (varies or has_portals or in_part)
                return sampled_world(light, device, beside_rays=beside)
            return sampled_world(light, device, even=True) if has_portals or in_part else None

        pixels, values = _key(scene, device)
        return self._last.get((pixels, (*values, varies, has_portals, in_part, beside_rays)), made)


def _may_vary(world: World) -> bool:
    """Whether texels do not show what scattered rays find: where only some kinds of them see the world, or it looks at
    the ray, of which texels know one kind.
    """
    in_part = int(world.visibility) & SCATTERED_RAYS != SCATTERED_RAYS
    asks = outputs_read(world.program.instructions, "light_path") - {_IS_CAMERA_RAY}
    return in_part or bool(asks) or not PATH_HISTORY_OPS.isdisjoint(world.program.ops)


def _key(scene: Scene, device: wp.Device) -> tuple[list[np.ndarray | None], tuple]:
    """What the brightness of the world's texels follows from: pixels and values."""
    world = scene.world
    images = images_of(scene, [world.program])
    kinds = tuple((int(image.encoding), tuple(number for number, _ in image.tiles or ())) for image in images)
    program = (world.program.instructions, world.program.constants.tobytes())
    pixels = [each for image in images for each in pictures_of(image)]
    return pixels, (device.alias, program, world.sampling_size, world.sun, camera_key(scene, [world.program]), kinds)
