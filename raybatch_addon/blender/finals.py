"""Final renders under way: viewports leave the sessions to them, from Blender's start of a render to its last frame."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
    """Notice, on Blender's main thread while it draws, a render of whose end Blender told nobody."""
    global _is_job
    if _is_job and not bpy.app.is_job_running("RENDER"):
        _is_job = False


@persistent
def _begin(scene: Any, *_: Any) -> None:
    global _is_job, job
    job += 1
    _is_job = scene is not None and scene.render.engine == "RAYBATCH"


@persistent
def _end(*_: Any) -> None:
    global _is_job
    _is_job = False


def register() -> None:
    """Have Blender tell of its renders."""
    for handlers, function in _handlers():
        handlers.append(function)


def unregister() -> None:
    """Have it tell no more."""
    _end()
    for handlers, function in _handlers():
        if function in handlers:
            handlers.remove(function)


def _handlers() -> tuple[tuple[Any, Any], ...]:
    told = bpy.app.handlers
    return (told.render_init, _begin), (told.render_complete, _end), (told.render_cancel, _end)
