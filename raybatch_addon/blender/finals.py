"""Final renders under way: viewports leave the sessions to them, from Blender's start of a render to its last frame.

Two facts are kept, as neither holds all the time: Blender's handlers know of the job, also between two of its frames
and before the first, but not of previews, nor of sessions that close; the count knows of these, and of every view layer
that is rendered, but not of what lies between.

Blender must not lose the engine in the middle of a render. Where the add-on is to go meanwhile, renders are asked to
end, as by Esc, and it goes once they have.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy
from bpy.app.handlers import persistent

# How often who waits for the end of renders looks whether there are any [s]
_LOOK_SECONDS = 0.05

_lock = threading.Lock()
_threads: list[int] = []  # those that render, once for each view layer and each step about it
_is_job = False  # Blender is in a render, maybe between two frames
_job_thread = 0
_ends = False  # renders are to end
_then: Callable[[], None] | None = None  # to be called once they have
job = 0  # number of the render that Blender is in, or was in last


@contextmanager
def under_way() -> Iterator[None]:
    """A final render is under way meanwhile."""
    own = threading.get_ident()
    with _lock:
        _threads.append(own)
    try:
        yield
    finally:
        with _lock:
            _threads.remove(own)


def are_under_way() -> bool:
    """Whether viewports are to wait; on any thread."""
    return _is_job or len(_threads) > 0


def look() -> None:
    """Notice, on Blender's main thread while it draws, a render whose end Blender did not report."""
    global _is_job
    if _is_job and not bpy.app.is_job_running("RENDER"):
        _is_job = False


def forget_job() -> None:
    """Blender is in no render, as at its end: it does not report that of an animation whose movie cannot be written."""
    global _is_job
    _is_job = False


def end_all() -> None:
    """Ask renders to end soon, those under way and those to come; on any thread."""
    global _ends
    _ends = True


def have_to_end() -> bool:
    """Whether renders were asked to; they look several times a second."""
    return _ends


def wait_for_end(seconds: float) -> bool:
    """Whether no render is under way, after at most `seconds`. On a thread that renders at once: it cannot wait for
    itself.
    """
    own, end = threading.get_ident(), time.monotonic() + seconds
    if not bpy.app.background and own != _job_thread:  # where a script waits for its render, Blender knows of no job
        look()
    while are_under_way():
        if own in _threads or (_is_job and own == _job_thread) or time.monotonic() > end:
            return False
        time.sleep(_LOOK_SECONDS)
    return True


def call_once_over(then: Callable[[], None]) -> None:
    """Call `then` when Blender's render ends, on its thread; in a Blender with a window when no render is under way, on
    the main thread.
    """
    global _then
    with _lock:
        _then = then
    if bpy.app.background:
        # Blender walks these lists while `then` takes handlers out of them: none may be behind the one that calls it
        for handlers in (bpy.app.handlers.render_complete, bpy.app.handlers.render_cancel):
            if _end in handlers:
                handlers.remove(_end)
                handlers.append(_end)
    elif not bpy.app.timers.is_registered(_call_if_over):
        # no handler is called behind a preview; and classes of the window's are removed where it is drawn
        bpy.app.timers.register(_call_if_over, first_interval=_LOOK_SECONDS, persistent=True)


def take_call() -> Callable[[], None] | None:
    """What was to be called, and is not any more."""
    global _then
    with _lock:
        then, _then = _then, None
    return then


def go_on() -> None:
    """Renders need not end."""
    global _ends
    _ends = False


@persistent
def _begin(scene: bpy.types.Scene | None, *_: object) -> None:
    global _is_job, _job_thread, job
    job += 1
    _job_thread = threading.get_ident()
    _is_job = scene is not None and scene.render.engine == "RAYBATCH"


@persistent
def _end(*_: object) -> None:
    forget_job()
    if bpy.app.background:
        _call()


def _call() -> None:
    if (then := take_call()) is not None:
        then()


def _call_if_over() -> float | None:
    """The timer of a Blender with a window: seconds to its next call."""
    look()
    if _then is not None and are_under_way():
        return _LOOK_SECONDS
    _call()
    return None


def register() -> None:
    """Follow Blender's renders from now on."""
    go_on()
    add_render_handlers(_begin, _end)


def unregister() -> None:
    """Follow them no longer."""
    global _is_job
    _is_job = False
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
