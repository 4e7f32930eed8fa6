"""The panel Compare: a line for each slot with a render, and how its settings differ from the newest."""

from __future__ import annotations

import bpy

from ..panel import LATER, EnginePanel, draw_lines
from .slots import RAYBATCH_OT_render_in_new_slot, RAYBATCH_OT_show_slot, known_renders, slots, unlike


class RAYBATCH_RENDER_PT_compare(EnginePanel, bpy.types.Panel):
    """The last renders, to compare."""

    bl_label = "Compare"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = LATER

    def draw(self, context):
        layout = self.layout
        layout.operator(RAYBATCH_OT_render_in_new_slot.bl_idname, icon="RENDER_STILL")
        there, found = slots(), known_renders()
        if there is None or not found:
            draw_lines(layout, context, ["Renders are listed here, to be shown side by side or one after another"])
            return
        newest = found[0][1]
        for index, each in found:
            column = layout.column(align=True)
            is_shown = there.active_index == index
            text = f"Slot {index + 1}"
            button = column.operator(RAYBATCH_OT_show_slot.bl_idname, text=text, icon="IMAGE_DATA", depress=is_shown)
            button.slot = index
            lines = [each.title]
            if each is not newest and (differing := unlike(each.settings, newest.settings)):
                lines.append(f"Here {'; '.join(differing)}")
            draw_lines(column, context, lines)


def register() -> None:
    """Add the panel."""
    bpy.utils.register_class(RAYBATCH_RENDER_PT_compare)


def unregister() -> None:
    """Remove the panel."""
    bpy.utils.unregister_class(RAYBATCH_RENDER_PT_compare)
