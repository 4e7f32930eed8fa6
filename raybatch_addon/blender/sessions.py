"""The sessions of this Blender, one a device: they hold the caches that outlive an engine object."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy

from ..core.device.devices import find_device, start_warp
from ..core.live.picture import LiveRequest
from ..core.session import Session
from ..core.settings.settings import RenderSettings
from .kernel_cache import kernel_cache_folder

# How often who waits for a session in the background asks whether it is still wanted [s]
_LOOK_SECONDS = 0.1

_sessions: dict[str, Session] = {}
_changed = threading.Condition()
_is_lent = False  # a session renders one picture at a time, and so do all of them together
_finals_waiting = 0
_views_waiting = 0


@contextmanager
def session_for(settings: RenderSettings) -> Iterator[Session]:
    """The session of the settings' device, to oneself, for a final render: viewports stop for it. Raises `DeviceError`
    for a device that is not there.
    """
    global _finals_waiting
    with _changed:
        _finals_waiting += 1
        try:
            _changed.wait_for(lambda: not _is_lent)
            _lend()
        finally:
            _finals_waiting -= 1
    try:
        yield _session_of(settings)
    finally:
        _give_back()


class ViewSessions:
    """Lends sessions to viewports: final renders go first, and viewports take turns."""

    @contextmanager
    def session(self, request: LiveRequest, given_up: Callable[[], bool]) -> Iterator[Session | None]:
        """As `SessionSource.session`."""
        global _views_waiting
        is_ours = False
        with _changed:
            _views_waiting += 1
            try:
                while not (is_ours := not _is_lent and not _finals_waiting) and not given_up():
                    _changed.wait(_LOOK_SECONDS)
                if is_ours:
                    _lend()
            finally:
                _views_waiting -= 1
        try:
            yield _session_of(request.settings) if is_ours else None
        finally:
            if is_ours:
                _give_back()

    def is_wanted(self, has_shown: bool) -> bool:
        """As `SessionSource.is_wanted`: by a final render at once, by another viewport once a picture came."""
        return _finals_waiting > 0 or (has_shown and _views_waiting > 0)


def close_all() -> None:
    """Give back what all sessions hold."""
    global _finals_waiting
    with _changed:
        _finals_waiting += 1
        try:
            _changed.wait_for(lambda: not _is_lent)
            for session in _sessions.values():
                session.close()
            _sessions.clear()
        finally:
            _finals_waiting -= 1


def _lend() -> None:
    global _is_lent
    _is_lent = True


def _give_back() -> None:
    global _is_lent
    with _changed:
        _is_lent = False
        _changed.notify_all()


def _session_of(settings: RenderSettings) -> Session:
    """The session of the device, for who was lent it."""
    start_warp(kernel_cache_folder())
    name = find_device(settings.device).alias
    if name not in _sessions:
        # a window stays when a picture is there; without one, Blender ends or goes on to the next frame
        _sessions[name] = Session(name, settings, compile_between_renders=not bpy.app.background)
    return _sessions[name]
