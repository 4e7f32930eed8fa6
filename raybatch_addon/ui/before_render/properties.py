"""How a scene is read, at `scene.raybatch_export`: settings of Blender's side that the core need not know."""

from __future__ import annotations

import bpy


class RayBatchExport(bpy.types.PropertyGroup):
    """How a scene is read."""

    strict: bpy.props.EnumProperty(
        name="Refuse to Render",
        description="Whether a scene is rendered that would lack something",
        items=[
            ("OFF", "Never", "Every scene is rendered; what is missing is listed"),
            ("MISSING", "If Something Is Missing", "Not if a part of the scene or of its output is left out"),
            ("REPLACED", "If Something Stands In", "Not either if something else takes the place of a part"),
            ("SETTING", "If a Setting Is Not Heard", "Not even if a setting of Cycles is passed over"),
        ],
        default="OFF",
        options=set(),
    )
    exposure: bpy.props.FloatProperty(
        name="Exposure",
        description="How many times as bright pictures are shown in Blender as the light is",
        default=1.0,
        min=0.0,
        max=10.0,
        options=set(),
    )
    material_output: bpy.props.EnumProperty(
        name="Material Output",
        description="Which output node counts where a material has one for each engine",
        items=[
            ("CYCLES", "Cycles", "The output for Cycles, or that for all engines"),
            ("EEVEE", "EEVEE", "The output for EEVEE, or that for all engines"),
        ],
        default="CYCLES",
        options=set(),
    )


def register() -> None:
    """Add `scene.raybatch_export`."""
    bpy.utils.register_class(RayBatchExport)
    bpy.types.Scene.raybatch_export = bpy.props.PointerProperty(
        type=RayBatchExport, name="RayBatch Export", description="How RayBatch reads a scene"
    )


def unregister() -> None:
    """Remove it."""
    del bpy.types.Scene.raybatch_export
    bpy.utils.unregister_class(RayBatchExport)
