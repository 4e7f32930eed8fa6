"""Blender's calls about the 3D view, passed on by the engine; the core is imported behind them, not waited for."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable

import bpy

from .. import finals, warm_up

_trouble = ""  # why there are no viewports


def view_update(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """The scene was edited, or `engine` is new."""
    if _is_ready(engine):
        engine.viewport.update(context, depsgraph)


def view_draw(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """The region is to be drawn."""
    if not _is_ready(engine):
        engine.update_stats("RayBatch", _trouble or "Starting")
        return
    engine.viewport.draw(engine, context, depsgraph)
    engine.update_stats(*engine.viewport.status())


def _is_ready(engine: bpy.types.RenderEngine) -> bool:
    """Whether `engine` has its viewport; where the core is not there yet, it draws again once it is."""
    global _trouble
    if engine.viewport is not None:
        if engine.viewport.is_closed and not finals.have_to_end():  # the add-on was to go, and stayed
            engine.viewport.open_again()
        return True
    redraw = _redraw_of(engine)
    if not warm_up.is_over(redraw):
        return False
    try:
        from .viewport import Viewport
    except Exception as error:  # Warp is missing, or does not fit
        _trouble = f"RayBatch cannot start: {type(error).__name__}: {error}"
        return False

    engine.viewport = Viewport(redraw)
    # Blender forgets what an engine is before Python forgets the engine: by then its attributes cannot be asked for
    weakref.finalize(engine, engine.viewport.close).atexit = False
    return True


def _redraw_of(engine: bpy.types.RenderEngine) -> Callable[[], None]:
    """What asks Blender to draw the region of `engine`, on any thread and as long as it is there."""
    reference = weakref.ref(engine)

    def redraw() -> None:
        with contextlib.suppress(ReferenceError):  # Blender has given it up meanwhile
            if (there := reference()) is not None:
                there.tag_redraw()

    return redraw
