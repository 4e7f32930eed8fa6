"""Holdout objects: holes for the camera, and objects as any other for all other rays."""

from __future__ import annotations

from dataclasses import replace

import bpy

from ...core.scene.description import Visibility
from .placements import Placements, Template


def is_holdout(
    placed: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object, view_layer: bpy.types.ViewLayer
) -> bool:
    """Whether `obj`, or what places it, is a holdout by itself or by a collection of `view_layer`."""
    owner = placed.parent if placed.is_instance and placed.parent else obj
    return obj.is_holdout or owner.original.holdout_get(view_layer=view_layer)


def with_hole(template: Template, placements: Placements, slots: int) -> tuple[Template, Template | None]:
    """The template of a holdout object with `slots` materials as two: what other rays than the camera's see, and what
    the camera sees; None in place of the second where one is all there is.
    """
    camera = template.visibility & int(Visibility.CAMERA)
    others = template.visibility & ~int(Visibility.CAMERA)  # with the bits of its shadow set, and of a catcher
    if not camera:
        return template, None
    first = len(placements.slot_materials)
    placements.slot_materials += [placements.materials.holdout()] * slots
    hole = replace(template, slot_first=first, visibility=camera)
    return (replace(template, visibility=others), hole) if others else (hole, None)
