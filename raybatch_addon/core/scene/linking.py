"""Objects and emitters that some rays alone see: emitters that light some objects alone or are aimed at from some
vertices of paths alone, objects that block some light alone, catchers.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from .description import (
    ALL_LIGHT_SETS,
    ALL_SHADOW_SETS,
    CATCHER_RAYS,
    CATCHER_SHIFT,
    SCATTERED_RAYS,
    SHADOW_SET_SHIFT,
    Light,
    LightKind,
    Scene,
    Visibility,
    Volume,
)

# Bits of visibilities that rays may have
RAY_BITS = int(Visibility.ALL) | ALL_SHADOW_SETS << SHADOW_SET_SHIFT | CATCHER_RAYS << CATCHER_SHIFT


def links_lights(scene: Scene) -> bool:
    """Whether some emitters of `scene` do not light every object."""
    links = scene.instances.links
    return any(light.light_sets != ALL_LIGHT_SETS for light in scene.lights) or (
        links is not None and bool(np.any(links[:, 1] != np.uint64(ALL_LIGHT_SETS)))
    )


def links_shadows(scene: Scene) -> bool:
    """Whether some objects of `scene` do not block the light of some emitters."""
    links = scene.instances.links
    return any(light.shadow_sets != ALL_SHADOW_SETS for light in scene.lights) or (
        links is not None and bool(np.any(links[:, 2] != np.uint64(ALL_SHADOW_SETS)))
    )


def limits_bounces(scene: Scene, bounce_max: int, world_light: bool) -> bool:
    """Whether some emitters of `scene` are aimed at from the first vertices alone of paths with `bounce_max` bounces.
    `world_light`: its world is an emitter.
    """
    limits = [light.bounce_max for light in scene.lights] + [scene.world.bounce_max] * world_light
    return any(limit is not None and limit < bounce_max for limit in limits)


def lifts_shadow_rays(scene: Scene) -> bool:
    """Whether shadow rays begin above the faces of some smooth meshes of `scene`."""
    cutoffs = scene.instances.terminator
    if cutoffs is None:
        return False
    smooth = np.array([mesh.corner_normals is not None and mesh.radii is None for mesh in scene.meshes], bool)
    return bool(np.any(smooth[scene.instances.mesh] & (cutoffs > 0)))


def catchers(scene: Scene) -> np.ndarray:
    """Which instances of `scene` are shadow catchers: bool, shape [n]."""
    return scene.instances.visibility >> CATCHER_SHIFT & CATCHER_RAYS != 0


def catcher_bits(visibility: int) -> int:
    """The bits of a visibility by which rays that see shadow catchers alone see a catcher that others see by
    `visibility`.
    """
    return (visibility & CATCHER_RAYS) << CATCHER_SHIFT


def shadow_bit(shadow_set: int) -> int:
    """The bit of a visibility that says that an instance is of this shadow set."""
    return 1 << (SHADOW_SET_SHIFT + shadow_set)


def light_rays(volumes: Collection[Volume]) -> int:
    """The kinds of scattered rays in a scene with these `volumes`: what none of them sees lights nothing."""
    return SCATTERED_RAYS | int(Visibility.VOLUME_SCATTER) if volumes else SCATTERED_RAYS


def can_be_met(light: Light) -> bool:
    """Whether rays other than those that are aimed at `light` may meet it."""
    rays = int(Visibility.ALL & ~Visibility.SHADOW)
    if not light.visibility & rays:
        return False
    if light.kind in (LightKind.POINT, LightKind.SPOT):
        return light.radius > 0
    if light.kind == LightKind.SUN:
        return light.angle > 0
    if light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE):
        return light.size[0] > 0 and light.size[1] > 0
    raise ValueError(f"there is no rule for whether rays meet lights of kind {light.kind!r}: add one here")
