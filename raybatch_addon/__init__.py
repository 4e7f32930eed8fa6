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
    import sys

    from . import engine, ui  # noqa: F401 - they are there when this goes on later
    from .blender import finals, missing, reports, warm_up  # noqa: F401

    warm_up.finish_warm_up()  # what it imports is whole from then on
    finals.take_call()  # for a render whose end Blender did not report
    finals.end_all()
    there = _modules_there()
    if (viewports := there.get("blender.viewport.viewport")) is not None:
        viewports.end_viewports()
    if finals.wait_for_end(_END_SECONDS):
        _unregister(there)
    else:
        print("RayBatch: a render is under way; RayBatch is disabled once it has ended", file=sys.stderr)
        finals.call_once_over(lambda: _unregister(there))


def _unregister(there: dict[str, ModuleType]) -> None:
    """`there` are the add-on's modules by the time it was to go: Blender may have forgotten them since."""
    import atexit

    import bpy

    there = {**_modules_there(), **there}
    atexit.unregister(_unregister_at_exit)
    there["blender.warm_up"].finish_warm_up()
    if (viewports := there.get("blender.viewport.viewport")) is not None:
        viewports.close_viewports()  # nobody knows their threads once Blender has dropped their engines
    bpy.utils.unregister_class(there["engine"].RayBatchRenderEngine)
    there["ui"].unregister()
    there["blender.finals"].unregister()
    if (sessions := there.get("blender.sessions")) is not None:
        sessions.close_all()
    for name, forget in (
        ("images.images", "forget_images"),
        ("meshes.kept_meshes", "forget_meshes"),
        ("kept_graphs", "forget_kept"),
    ):
        if (kept := there.get(f"export.{name}")) is not None:
            getattr(kept, forget)()
    there["blender.reports"].clear()
    there["blender.missing"].forget_found()


def _modules_there() -> dict[str, ModuleType]:
    """The add-on's modules that were imported, by their names in it: most are where something was rendered alone."""
    import sys

    beginning = f"{__name__}."
    return {name[len(beginning) :]: module for name, module in [*sys.modules.items()] if name.startswith(beginning)}


def _unregister_at_exit() -> None:
    if not globals().get("__addon_enabled__"):  # what Blender enabled as an add-on, it disables itself
        from .blender import finals

        finals.forget_job()
        unregister()
