"""Final renders under way: viewports leave the sessions to them, from Blender's start of a render to its last frame.

Two facts are kept, as neither holds all the time: Blender's handlers know of the job, also between two of its frames
and before the first, but not of previews, nor of sessions that close; the count knows of these, and of every view layer
that is rendered, but not of what lies between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy
from bpy.app.handlers import persistent

_lock = threading.Lock()
_count = 0  # renders of view layers
_is_job = False  # Blender is in a render, maybe between two frames
job = 0  # number of the render that Blender is in, or was in last


@contextmanager
def under_way() -> Iterator[None]:
    """A final render is under way meanwhile."""
    global _count
    with _lock:
        _count += 1
    try:
        yield
    finally:
        with _lock:
            _count -= 1


def are_under_way() -> bool:
    """Whether viewports are to wait; on any thread."""
    return _is_job or _count > 0


def look() -> None:
    """Notice, on Blender's main thread while it draws, a render whose end Blender did not report."""
    global _is_job
    if _is_job and not bpy.app.is_job_running("RENDER"):
        _is_job = False


@persistent
def _begin(scene: bpy.types.Scene | None, *_: object) -> None:
    global _is_job, job
    job += 1
    _is_job = scene is not None and scene.render.engine == "RAYBATCH"


@persistent
def _end(*_: object) -> None:
    global _is_job
    _is_job = False


def register() -> None:
    """Follow Blender's renders from now on."""
    add_render_handlers(_begin, _end)


def unregister() -> None:
    """Follow them no longer."""
    _end()
    remove_render_handlers(_begin, _end)


def add_render_handlers(begin: Callable[..., None], end: Callable[..., None]) -> None:
    """Have Blender call `begin` before each render and `end` behind it, whether it is complete or cancelled."""
    for handlers, function in _handlers(begin, end):
        handlers.append(function)


def remove_render_handlers(begin: Callable[..., None], end: Callable[..., None]) -> None:
    """Undo `add_render_handlers`."""
    for handlers, function in _handlers(begin, end):
        if function in handlers:
            handlers.remove(function)


def _handlers(begin: Callable[..., None], end: Callable[..., None]) -> list[tuple[list, Callable[..., None]]]:
    events = bpy.app.handlers
    return [(events.render_init, begin), (events.render_complete, end), (events.render_cancel, end)]
