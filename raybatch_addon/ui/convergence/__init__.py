"""The panel Convergence: error and rays a second over time of the last renders, live and to compare."""

from __future__ import annotations

import bpy
import bpy.utils.previews

from ...convergence.records import store
from ..panel import register_all, unregister_all
from .operators import (
    RAYBATCH_OT_convergence_clear,
    RAYBATCH_OT_convergence_copy,
    RAYBATCH_OT_convergence_hide,
    RAYBATCH_OT_convergence_keep,
    RAYBATCH_OT_convergence_plot,
    RAYBATCH_OT_convergence_save,
)
from .panel import RAYBATCH_RENDER_PT_convergence
from .properties import RayBatchConvergence
from .shown import IDLE_SECONDS, Shown, follow, forget_image

_classes = (
    RayBatchConvergence,
    RAYBATCH_OT_convergence_keep,
    RAYBATCH_OT_convergence_hide,
    RAYBATCH_OT_convergence_clear,
    RAYBATCH_OT_convergence_plot,
    RAYBATCH_OT_convergence_copy,
    RAYBATCH_OT_convergence_save,
    RAYBATCH_RENDER_PT_convergence,
)


def _handlers() -> tuple[list, ...]:
    return bpy.app.handlers.load_post, bpy.app.handlers.undo_post, bpy.app.handlers.redo_post


def register() -> None:
    """Add the panel, its operators and what it remembers; and look at the record from now on."""
    register_all(_classes)
    bpy.types.Scene.raybatch_convergence = bpy.props.PointerProperty(
        type=RayBatchConvergence, name="RayBatch Convergence", description="What the panel Convergence remembers"
    )
    Shown.previews = bpy.utils.previews.new()
    for handlers in _handlers():
        handlers.append(forget_image)
    if not bpy.app.background:
        bpy.app.timers.register(follow, first_interval=IDLE_SECONDS, persistent=True)


def unregister() -> None:
    """Remove all of it, and forget the runs."""
    if bpy.app.timers.is_registered(follow):
        bpy.app.timers.unregister(follow)
    for handlers in _handlers():
        handlers.remove(forget_image)
    bpy.utils.previews.remove(Shown.previews)
    Shown.previews = Shown.image = Shown.followed = None
    Shown.panels.clear()
    store.clear()
    del bpy.types.Scene.raybatch_convergence
    unregister_all(_classes)
