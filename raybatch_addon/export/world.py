"""Blender's world as the core's `World`."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.scene.description import Visibility, World
from .emission_nodes import constant_emission, has_volume
from .nodes.graph import NotUnderstood


def export_world(world: bpy.types.World | None, warnings: list[str]) -> World:
    """`world` as it lights the scene, black where there is none.

    What is not constant falls back to the world's viewport colour; `warnings` gets a line for everything that was replaced.
    """
    if world is None:
        return World()
    radiance = np.array(world.color[:3], float)
    if has_nodes(world):
        try:
            radiance = constant_emission(world.node_tree)
        except NotUnderstood as reason:
            warnings.append(f"world “{world.name}”: {reason}: this is not supported yet; the world has its viewport colour instead")
        if has_volume(world.node_tree):
            warnings.append(f"world “{world.name}”: volumes are not supported; the world's volume is left out")
    return World(radiance=usable_emission(radiance, f"world “{world.name}”", warnings), visibility=_visibility(world))


def has_nodes(owner) -> bool:
    """Whether a light or world is described by its nodes. From Blender 5.0 on it is wherever it has a tree."""
    return owner.node_tree is not None and (bpy.app.version >= (5, 0) or owner.use_nodes)


def usable_emission(emission: np.ndarray, name: str, warnings: list[str]) -> tuple[float, float, float]:
    """`emission` without what cannot be rendered; each repair is warned of."""
    if not np.isfinite(emission).all():
        warnings.append(f"{name}: its strength is not a finite number; it is taken as 0")
        emission = np.where(np.isfinite(emission), emission, 0)
    if (emission < 0).any():
        warnings.append(f"{name}: negative strength is not supported; it is taken as 0")
        emission = np.maximum(emission, 0)
    red, green, blue = (float(c) for c in emission)
    return red, green, blue


def _visibility(world: bpy.types.World) -> int:
    # these settings belong to Cycles, and are there as long as that add-on is enabled
    flags = getattr(world, "cycles_visibility", None)
    seen = Visibility.SHADOW
    for name in ("camera", "diffuse", "glossy", "transmission"):
        if getattr(flags, name, True):
            seen |= Visibility[name.upper()]
    return int(seen)
