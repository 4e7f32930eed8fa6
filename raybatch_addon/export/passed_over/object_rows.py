"""Settings of objects that are passed over."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.scene.notice import Weight
from .row import Row


def _cycles(obj: bpy.types.Object, name: str) -> Any:
    return getattr(getattr(obj, "cycles", None), name, False)


def _casts_caustics(obj: bpy.types.Object) -> bool:
    lamp = obj.data if obj.type == "LIGHT" else None
    return bool(getattr(getattr(lamp, "cycles", None), "is_caustics_light", False))


OBJECT_ROWS = (
    Row(
        "shadow caustics of Cycles are not supported: the light of these comes through glass by whole paths alone: "
        "{found}",
        _casts_caustics,
        Weight.SETTING,
        "turn off Shadow Caustics of the light",
    ),
    Row(
        "Volume Scatter of Ray Visibility is not heard; light that volumes scatter meets these all the same: {found}",
        lambda obj: not getattr(obj, "visible_volume_scatter", True),
        Weight.SETTING,
        "turn it on in the object's properties",
    ),
    Row(
        "Cycles' culling of objects is not supported; these are rendered wherever they are: {found}",
        lambda obj: _cycles(obj, "use_camera_cull") or _cycles(obj, "use_distance_cull"),
        Weight.SETTING,
        "turn off Camera Cull and Distance Cull of the object",
    ),
)
