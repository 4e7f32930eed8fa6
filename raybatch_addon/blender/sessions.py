"""The sessions of this Blender, one a device: they hold the caches that outlive an engine object."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..core.device.devices import find_device, start_warp
from ..core.session import Session
from ..core.settings.settings import RenderSettings
from .kernel_cache import kernel_cache_folder

_sessions: dict[str, Session] = {}
_lock = threading.Lock()  # a session renders one picture at a time


@contextmanager
def session_for(settings: RenderSettings) -> Iterator[Session]:
    """The session of the settings' device, to oneself. Raises `DeviceError` for a device that is not there."""
    with _lock:
        start_warp(kernel_cache_folder())
        name = find_device(settings.device).alias
        if name not in _sessions:
            # a window stays when a picture is there; without one, Blender ends or goes on to the next frame
            _sessions[name] = Session(name, settings, compile_between_renders=not bpy.app.background)
        yield _sessions[name]


def close_all() -> None:
    """Give back what all sessions hold."""
    with _lock:
        for session in _sessions.values():
            session.close()
        _sessions.clear()
