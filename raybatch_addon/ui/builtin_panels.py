"""Blender's own panels that apply to RayBatch, and not those that would do nothing."""

from __future__ import annotations

import bpy

from .panel import ENGINE, EnginePanel, register_all, unregister_all

# Every panel for engines of Blender's general kind is taken, without those of what is not rendered
_GENERAL = "BLENDER_RENDER"
_LEFT_OUT = {
    "DATA_PT_light",  # the fuller DATA_PT_EEVEE_light is taken
    "NODE_DATA_PT_light",
    "PHYSICS_PT_fluid_domain_render",
}
_SIMPLIFY = "RENDER_PT_simplify"  # Blender draws it above all others; the panels below are in its place
_LEFT_OUT_FAMILIES = ("DATA_PT_lightprobe", "DATA_PT_context_lightprobe", _SIMPLIFY)

# Panels that Blender made for EEVEE and that say nothing special to it
_TAKEN = {
    "DATA_PT_EEVEE_light",
    "NODE_DATA_PT_EEVEE_light",
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "EEVEE_MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_MATERIAL_PT_volume",
    "EEVEE_MATERIAL_PT_displacement",
    "EEVEE_WORLD_PT_surface",
    "EEVEE_WORLD_PT_volume",
    "EEVEE_WORLD_PT_mist",
}

_added: list[type[bpy.types.Panel]] = []


def _simplify_panels() -> list[type]:
    """Blender's panel Simplify and those in it as panels of this engine, which have their place among its others."""
    made: list[type[bpy.types.Panel]] = []
    for name in ("", "_viewport", "_render", "_greasepencil"):
        builtin = getattr(bpy.types, f"{_SIMPLIFY}{name}", None)
        if builtin is None:
            continue
        values = {
            "__doc__": "As Blender's own panel.",
            "bl_label": builtin.bl_label,
            "bl_options": set(getattr(builtin, "bl_options", ())),
            "draw": builtin.draw,
        }
        if name:
            values["bl_parent_id"] = made[0].__name__
        else:
            values["draw_header"] = builtin.draw_header
        made.append(type(f"RAYBATCH_{_SIMPLIFY}{name}", (EnginePanel, bpy.types.Panel), values))
    return made


_own: list[type] = []


def _applies(panel: type[bpy.types.Panel]) -> bool:
    name = panel.__name__
    if name in _TAKEN:
        return True
    return _GENERAL in panel.COMPAT_ENGINES and name not in _LEFT_OUT and not name.startswith(_LEFT_OUT_FAMILIES)


def register() -> None:
    """Enable them for the engine."""
    _own[:] = _simplify_panels()
    register_all(_own)
    for panel in bpy.types.Panel.__subclasses__():
        if hasattr(panel, "COMPAT_ENGINES") and ENGINE not in panel.COMPAT_ENGINES and _applies(panel):
            panel.COMPAT_ENGINES.add(ENGINE)
            _added.append(panel)


def unregister() -> None:
    """Disable exactly those again."""
    unregister_all(_own)
    _own.clear()
    for panel in _added:
        panel.COMPAT_ENGINES.discard(ENGINE)
    _added.clear()
