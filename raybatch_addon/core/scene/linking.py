"""Light linking: whether emitters light some objects alone, and whether some objects alone block their light."""

from __future__ import annotations

import numpy as np

from .description import ALL_LIGHT_SETS, ALL_SHADOW_SETS, SHADOW_SET_SHIFT, Scene, Visibility

# Bits of visibilities that rays may have
RAY_BITS = int(Visibility.ALL) | ALL_SHADOW_SETS << SHADOW_SET_SHIFT


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


def shadow_bit(shadow_set: int) -> int:
    """The bit of a visibility that says that an instance is of this shadow set."""
    return 1 << (SHADOW_SET_SHIFT + shadow_set)
