"""Operators: try schedules, and take the fastest."""

from __future__ import annotations

import sys
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ...blender.finals import add_render_handlers, remove_render_handlers
from ...export.settings import assign_setting
from ..compare.slots import take_next_slot
from ..panel import may_render, register_all, unregister_all


class RAYBATCH_OT_tune(bpy.types.Operator):
    """Render the scene for seconds with each of some ways to trace rays, and on each device, and show the fastest. The
    picture is the same with all of them; nothing is changed before you take the fastest
    """

    bl_idname = "raybatch.tune"
    bl_label = "Tune"

    seconds: bpy.props.FloatProperty(
        name="Seconds", description="How long each of them renders", default=3.0, min=0.05, max=600.0
    )

    @classmethod
    def poll(cls, context):
        return may_render(cls, context)

    def invoke(self, context, _event):
        from ...blender import tuning

        take_next_slot()  # the last picture stays
        tuning.ask_for_tuning(context.scene.name, self.seconds)
        started = bpy.ops.render.render("INVOKE_DEFAULT")
        if "CANCELLED" in started:
            tuning.withdraw_tuning()
        return started & {"FINISHED", "CANCELLED"} or {"FINISHED"}

    def execute(self, context):
        from ...blender import tuning

        tuning.ask_for_tuning(context.scene.name, self.seconds)
        try:
            return bpy.ops.render.render()
        finally:
            tuning.withdraw_tuning()


class RAYBATCH_OT_take_fastest(bpy.types.Operator):
    """Set what was found to be the fastest"""

    bl_idname = "raybatch.take_fastest"
    bl_label = "Use the Fastest"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        from ...blender import tuning

        found = tuning.last_tuned()
        return context.scene is not None and found is not None and found.tuning.best is not None

    def execute(self, context):
        from ...blender import tuning

        found = tuning.last_tuned()
        assert found is not None and found.tuning.best is not None  # as `poll` found
        for name, value in found.tuning.best.changes.items():
            assign_setting(context.scene.raybatch, name, value)
        return {"FINISHED"}


_classes = (RAYBATCH_OT_tune, RAYBATCH_OT_take_fastest)


def _tuning() -> Any | None:
    """The module, once it is there: it brings in the core, which registering does not wait for."""
    return sys.modules.get(f"{__package__.rpartition('.ui')[0]}.blender.tuning")


@persistent
def _begin(*_: object) -> None:
    if (tuning := _tuning()) is not None:
        tuning.begin_tuning()


@persistent
def _end(*_: object) -> None:
    if (tuning := _tuning()) is not None:
        tuning.withdraw_tuning()


def register() -> None:
    """Add the operators, and follow the renders of Blender."""
    register_all(_classes)
    add_render_handlers(_begin, _end)


def unregister() -> None:
    """Remove the operators, and what was found."""
    remove_render_handlers(_begin, _end)
    if (tuning := _tuning()) is not None:
        tuning.forget_tuned()
    unregister_all(_classes)
