"""Settings of objects that are passed over."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.scene.notice import Weight
from .row import Row

# Types of objects whose surface light falls on
_SURFACES = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD")


def _cycles(obj: bpy.types.Object, name: str) -> Any:
    return getattr(getattr(obj, "cycles", None), name, False)


def _casts_caustics(obj: bpy.types.Object) -> bool:
    lamp = obj.data if obj.type == "LIGHT" else None
    return bool(getattr(getattr(lamp, "cycles", None), "is_caustics_light", False))


def _is_aimed_at_alone(obj: bpy.types.Object) -> bool:
    """Whether scattered rays would not meet a lamp that has a size."""
    if obj.type != "LIGHT" or getattr(getattr(obj.data, "cycles", None), "use_multiple_importance_sampling", True):
        return False
    size = {"SUN": "angle", "AREA": "size"}.get(obj.data.type, "shadow_soft_size")
    return getattr(obj.data, size) > 0 and not getattr(obj.data.cycles, "is_portal", False)


def _shifts_terminator(obj: bpy.types.Object) -> bool:
    return obj.type in _SURFACES and getattr(obj, "shadow_terminator_shading_offset", 0.0) > 0


OBJECT_ROWS = (
    Row(
        "Shading Offset of the shadow terminator is not supported; these are shaded as at 0: {found}",
        _shifts_terminator,
        Weight.REPLACED,
        "set Shading Offset to 0 in the object's Shading settings, and give the mesh more faces",
    ),
    Row(
        "shadow caustics of Cycles are not supported: the light of these comes through glass by whole paths alone: "
        "{found}",
        _casts_caustics,
        Weight.SETTING,
        "turn off Shadow Caustics of the light",
    ),
    Row(
        "Multiple Importance off is not heard: mirrors and clear glass show these lamps all the same: {found}",
        _is_aimed_at_alone,
        Weight.SETTING,
        "turn it on in the lamp's settings of Cycles",
    ),
    Row(
        "Cycles' culling of objects is not supported; these are rendered wherever they are: {found}",
        lambda obj: _cycles(obj, "use_camera_cull") or _cycles(obj, "use_distance_cull"),
        Weight.SETTING,
        "turn off Camera Cull and Distance Cull of the object",
    ),
)
