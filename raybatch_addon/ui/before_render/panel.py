"""The panel of what a render would lack, with a button to what each line is about."""

from __future__ import annotations

import bpy

from ...blender import missing
from ...core.errors import SettingsError
from ...core.scene.notice import Notice, Weight
from ...export.taken_over.rows import CYCLES, EEVEE
from ...export.taken_over.take import ENGINE_LABELS, differences
from .. import migration
from ..panel import (
    ICON_WIDTH,
    LATER,
    EnginePanel,
    draw_below_name,
    draw_box,
    draw_lines,
    free_width,
    label_width,
    register_all,
    unregister_all,
)
from .operators import RAYBATCH_OT_check_scene, RAYBATCH_OT_select_object, RAYBATCH_OT_settings_from

ICONS = {Weight.MISSING: "ERROR", Weight.REPLACED: "QUESTION", Weight.SETTING: "PREFERENCES", Weight.REPAIRED: "INFO"}
SHOWN_MOST = 20  # lines; the others are in the statistics


class RAYBATCH_RENDER_PT_before_render(EnginePanel, bpy.types.Panel):
    """What a render of this scene would lack."""

    bl_label = "Before the Render"
    bl_order = LATER
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        found = missing.found_in(context.scene)
        if migration.complaint(context.scene):
            self.layout.label(text="", icon="ERROR")
        elif found:
            self.layout.label(text="", icon=ICONS[found[0].weight])

    def draw(self, context):
        layout = self.layout
        if newer := migration.complaint(context.scene):
            draw_box(layout, context, newer, "ERROR")
        draw_below_name(layout, context.scene.raybatch_export, "strict", "Refuse to Render")
        layout.operator(RAYBATCH_OT_check_scene.bl_idname, icon="VIEWZOOM")
        found = missing.found_in(context.scene)
        if found is None:
            return
        for number, notice in enumerate(found[:SHOWN_MOST]):
            _draw_notice(layout, context, number, notice)
        if len(found) > SHOWN_MOST:
            layout.label(text=f"and {len(found) - SHOWN_MOST} more")
        if not found:
            layout.label(text="Nothing is missing", icon="CHECKMARK")


def _draw_notice(layout, context, number: int, notice: Notice) -> None:
    box = layout.box()
    draw_lines(box, context, [notice], ICONS[notice.weight], in_box=True)
    if notice.remedy:
        draw_lines(box, context, [f"To do: {notice.remedy}"], in_box=True)
    if notice.objects:
        text = f"Select {notice.objects[0] if len(notice.objects) == 1 else f'{len(notice.objects)} objects'}"
        if label_width(text) > free_width(context, in_box=True) - ICON_WIDTH:
            text = "Select the object"  # which the line names
        select = box.operator(RAYBATCH_OT_select_object.bl_idname, text=text, icon="RESTRICT_SELECT_OFF")
        select.number = number


class RAYBATCH_RENDER_PT_settings_from(EnginePanel, bpy.types.Panel):
    """Settings of Cycles and EEVEE that are others here."""

    bl_label = "Settings of Other Engines"
    bl_options = {"DEFAULT_CLOSED"}
    bl_parent_id = "RAYBATCH_RENDER_PT_before_render"

    def draw(self, context):
        layout = self.layout
        draw_below_name(layout, context.scene.raybatch_export, "material_output", "Material Output")
        for engine in (CYCLES, EEVEE):
            text = f"Settings From {ENGINE_LABELS[engine]}"
            layout.operator(RAYBATCH_OT_settings_from.bl_idname, text=text, icon="IMPORT").engine = engine
            try:
                found = differences(context.scene, engine)
            except SettingsError as error:
                draw_box(layout, context, str(error), "ERROR")
                continue
            draw_lines(layout, context, [each.text(engine) for each in found] or ["They are the same"])


_classes = (RAYBATCH_RENDER_PT_before_render, RAYBATCH_RENDER_PT_settings_from)


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
