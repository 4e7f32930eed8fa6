"""The panel of how curves and hair are shaped, whose settings Blender shows to Cycles alone."""

from __future__ import annotations

import bpy

from ..panel import EnginePanel, choice_text, draw_why, register_all, split_layout, unregister_all


class RAYBATCH_RENDER_PT_curves(EnginePanel, bpy.types.Panel):
    """The shape of curves and hair: settings of Cycles."""

    bl_label = "Curves"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and hasattr(context.scene, "cycles_curves")

    def draw(self, context):
        layout = split_layout(self.layout)
        own = context.scene.cycles_curves
        layout.prop(own, "shape")
        column, is_cut = layout.column(), own.shape == "RIBBONS"  # round curves are cut as finely as they bend
        column.active = is_cut
        column.prop(own, "subdivisions", text="Subdivisions")
        draw_why(layout, context, "" if is_cut else f"Unused with Shape {choice_text(own, 'shape')}")


_classes = (RAYBATCH_RENDER_PT_curves,)


def register() -> None:
    """Add the panel."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panel."""
    unregister_all(_classes)
