"""The look at a scene: all that is passed over in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import bpy

from ...core.scene.description import ClosureKind, Scene
from ...core.scene.features import emits_somewhere, scene_volumes
from ...core.scene.notice import Notice, Weight, about
from ..taken_over.take import passed_over_settings
from .object_rows import OBJECT_ROWS
from .row import notices, object_notices
from .scene_rows import SCENE_ROWS


def passed_over(depsgraph: bpy.types.Depsgraph, objects: Iterable[bpy.types.Object]) -> list[Notice]:
    """Settings of the depsgraph's scene and view layer, and of the `objects` that are rendered, that are not heard."""
    scene, layer = depsgraph.scene, depsgraph.view_layer
    found = [
        about(each, f"scene “{scene.name}”, view layer “{layer.name}”") for each in notices(SCENE_ROWS, scene, layer)
    ]
    objects = list(objects)
    found += object_notices(OBJECT_ROWS, objects)
    return found + passed_over_settings(scene)


def with_light_looked_for(scene: Scene) -> Scene:
    """`scene`, with a notice first where nothing in it can give light."""
    shines = bool(scene.lights) or scene.world.program is not None or any(scene.world.radiance)
    emits = any(ClosureKind.EMISSION in material.kinds for material in scene.materials)
    if shines or emits or any(map(emits_somewhere, scene_volumes(scene))):
        return scene
    text = (
        "nothing gives light: there is no lamp, no world that shines and no material that emits; the picture is black"
    )
    remedy = "add a light (Add > Light), or give the world a colour that is not black"
    return dataclasses.replace(scene, warnings=(Notice(text, Weight.MISSING, remedy=remedy), *scene.warnings))
