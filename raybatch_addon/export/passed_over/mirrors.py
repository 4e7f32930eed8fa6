"""Lamps that mirrors show in Cycles through what does not block them."""

from __future__ import annotations

import numpy as np

from ...core.scene.description import ALL_SHADOW_SETS, SHADOW_SETS, ClosureKind, Material, Scene, Visibility
from ...core.scene.linking import can_be_met
from ...core.scene.notice import Notice, quoted
from ...core.shading.bsdf.ggx import ALPHA_MIN
from ...core.shading.bsdf.materials import MICROFACET_KINDS

_MIRRORS = MICROFACET_KINDS - {ClosureKind.SUBSURFACE}
_SEEN = int(Visibility.GLOSSY | Visibility.TRANSMISSION)


def lamps_hidden_from_mirrors(scene: Scene) -> list[Notice]:
    """A notice where mirrors and clear glass do not show what shines through objects that its Shadow Linking excludes;
    or none. Emitters whose collections include blockers are hidden in Cycles too.
    """
    names = [
        light.name
        for light in scene.lights
        if _excludes(light.shadow_sets) and light.visibility & _SEEN and can_be_met(light)
    ]
    instances = scene.instances
    if instances.links is not None:
        slots_of: dict[int, list[int]] = {}
        for instance in np.flatnonzero(instances.links[:, 2] != np.uint64(ALL_SHADOW_SETS)).tolist():
            if _excludes(int(instances.links[instance, 2])) and _emits(scene, instance, slots_of):
                names.append(scene.object_names[int(instances.object[instance])])
    if not names or not any(map(_may_mirror, scene.materials)):
        return []
    text = (
        "mirrors and clear glass show what has Shadow Linking where nothing at all is in the way, also what does not "
        f"block its light: {quoted(names)}"
    )
    remedy = f"give mirrors a roughness of at least {_roughness_least():.2f}"
    return [Notice(text, objects=dict.fromkeys(names), remedy=remedy)]


def _excludes(sets: int) -> bool:
    """Whether all but some objects block: then those do that are in no set, too."""
    return sets != ALL_SHADOW_SETS and bool(sets >> (SHADOW_SETS - 1) & 1)


def _emits(scene: Scene, instance: int, slots_of: dict[int, list[int]]) -> bool:
    """Whether mirrors would see light of `instance`; `slots_of` gains the slots that its mesh uses, found once."""
    if not int(scene.instances.visibility[instance]) & _SEEN:
        return False
    mesh = int(scene.instances.mesh[instance])
    if mesh not in slots_of:
        slots = scene.meshes[mesh].triangle_slot
        slots_of[mesh] = np.unique(slots).tolist() if slots is not None else [0]
    first = int(scene.instances.slot_first[instance])
    materials = (scene.materials[int(scene.slot_materials[first + slot])] for slot in slots_of[mesh])
    return any(ClosureKind.EMISSION in each.kinds for each in materials)


def _may_mirror(material: Material) -> bool:
    if material.program is not None:
        return not _MIRRORS.isdisjoint(material.kinds)
    return any(each.kind in _MIRRORS and each.roughness**2 < ALPHA_MIN for each in material.closures)


def _roughness_least() -> float:
    """The least roughness, in hundredths, at which a surface is no mirror."""
    return np.ceil(100 * ALPHA_MIN**0.5) / 100
