"""RayBatch: a path tracer that batches rays, for Blender."""

# SPDX-License-Identifier: GPL-3.0-or-later

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType

# `import raybatch_addon.core` works where there is no Blender; `register()` brings in Blender's side.


# A render that was asked to end and has not by then keeps the engine until it does [s]
_END_SECONDS = 60.0


def register() -> None:
    """Add the engine, its settings and its panels to Blender."""
    import atexit

    import bpy

    from . import engine, ui
    from .blender import finals

    if (unregistered_later := finals.take_call()) is not None:
        if finals.are_under_way():  # all is still there
            finals.go_on()
            return
        unregistered_later()
    ui.register()
    bpy.utils.register_class(engine.RayBatchRenderEngine)
    finals.register()
    if bpy.app.module:
        # Python ends before Blender here, and Blender 4.5 waits for ever on classes that are still registered
        atexit.register(_unregister_at_exit)


def unregister() -> None:
    """Remove everything that `register` added, and give back what is cached. Renders under way are ended first, as by
    Esc; where this is called by one of them, what it needs goes when it ends.
    """
    from .blender import finals

    finals.end_all()
    if (viewports := _module_there("blender.viewport.viewport")) is not None:
        viewports.end_viewports()
    if finals.wait_for_end(_END_SECONDS):
        _unregister()
    else:
        finals.call_once_over(_unregister)


def _unregister() -> None:
    import atexit

    import bpy

    from . import engine, ui
    from .blender import finals, missing, reports, warm_up

    atexit.unregister(_unregister_at_exit)
    if (viewports := _module_there("blender.viewport.viewport")) is not None:
        viewports.close_viewports()  # nobody knows their threads once Blender has dropped their engines
    bpy.utils.unregister_class(engine.RayBatchRenderEngine)
    ui.unregister()
    finals.unregister()
    warm_up.finish_warm_up()
    if (sessions := _module_there("blender.sessions")) is not None:
        sessions.close_all()
    for name, forget in (
        ("images.images", "forget_images"),
        ("meshes.kept_meshes", "forget_meshes"),
        ("kept_graphs", "forget_kept"),
    ):
        if (kept := _module_there(f"export.{name}")) is not None:
            getattr(kept, forget)()
    reports.clear()
    missing.forget_found()


def _module_there(name: str) -> ModuleType | None:
    """A module of the add-on that something was rendered with; None where nothing was."""
    import sys

    return sys.modules.get(f"{__name__}.{name}")


def _unregister_at_exit() -> None:
    if not globals().get("__addon_enabled__"):  # what Blender enabled as an add-on, it disables itself
        unregister()
