"""RayBatch: a path tracer that batches rays, for Blender."""

# SPDX-License-Identifier: GPL-3.0-or-later

# `import raybatch_addon.core` works where there is no Blender; `register()` brings in Blender's side.


def register() -> None:
    """Add the engine, its settings and its panels to Blender."""
    import atexit

    import bpy

    from . import engine, ui
    from .blender import finals

    ui.register()
    bpy.utils.register_class(engine.RayBatchRenderEngine)
    finals.register()
    if bpy.app.module:
        # Python ends before Blender here, and Blender 4.5 waits for ever on classes that are still registered
        atexit.register(_unregister_at_exit)


def unregister() -> None:
    """Remove everything that `register` added, and give back what is cached."""
    import atexit
    import sys

    import bpy

    from . import engine, ui
    from .blender import finals, missing, reports

    atexit.unregister(_unregister_at_exit)
    bpy.utils.unregister_class(engine.RayBatchRenderEngine)
    ui.unregister()
    finals.unregister()
    viewports = sys.modules.get(f"{__name__}.blender.viewport.viewport")
    if viewports is not None:
        viewports.close_viewports()
    sessions = sys.modules.get(f"{__name__}.blender.sessions")  # there if something was rendered
    if sessions is not None:
        sessions.close_all()
    for module, forget in (
        ("images.images", "forget_images"),
        ("meshes.kept_meshes", "forget_meshes"),
        ("kept_graphs", "forget_kept"),
    ):
        if (kept := sys.modules.get(f"{__name__}.export.{module}")) is not None:
            getattr(kept, forget)()
    reports.clear()
    missing.forget_found()


def _unregister_at_exit() -> None:
    if not globals().get("__addon_enabled__"):  # what Blender enabled as an add-on, it disables itself
        unregister()
