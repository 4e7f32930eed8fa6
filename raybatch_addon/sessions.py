"""The sessions of this Blender, one a device: they hold the caches that outlive an engine object."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from .core.session import Session
from .core.settings import RenderSettings

_sessions: dict[str, Session] = {}
_lock = threading.Lock()  # a session renders one picture at a time


@contextmanager
def session_for(settings: RenderSettings) -> Iterator[Session]:
    """The session of the settings' device, to oneself. Raises `DeviceError` for a device that is not there."""
    with _lock:
        name = settings.device.lower()
        if name not in _sessions:
            _sessions[name] = Session(settings.device, settings, cache_folder())
        yield _sessions[name]


def cache_folder() -> Path | None:
    """Where kernels are kept: the extension's own folder of the user, or None (the core's default) when not installed as one."""
    package = __package__ or ""
    if not package.startswith("bl_ext."):
        return None
    return Path(bpy.utils.extension_path_user(package, path="kernels", create=True))


def close_all() -> None:
    """Give back what all sessions hold."""
    with _lock:
        for session in _sessions.values():
            session.close()
        _sessions.clear()
