"""The path tracer, which knows nothing of Blender: `session.py` is its only door."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import DeviceError, OutOfMemoryError, RayBatchError, SceneError, SettingsError
    from .film import Film
    from .observers import Progress, RenderObserver, Tile
    from .scene import description
    from .scene.archive import load_scene, save_scene
    from .scene.description import Frame, Scene
    from .session import Session
    from .settings.settings import RenderSettings
    from .version import VERSION

__all__ = [
    "VERSION",
    "DeviceError",
    "Film",
    "Frame",
    "OutOfMemoryError",
    "Progress",
    "RayBatchError",
    "RenderObserver",
    "RenderSettings",
    "Scene",
    "SceneError",
    "Session",
    "SettingsError",
    "Tile",
    "description",
    "load_scene",
    "save_scene",
]

# Where the names of the library are: they are imported when they are asked for, because some bring in Warp
_MODULES = {
    "VERSION": "version",
    "DeviceError": "errors",
    "Film": "film",
    "Frame": "scene.description",
    "OutOfMemoryError": "errors",
    "Progress": "observers",
    "RayBatchError": "errors",
    "RenderObserver": "observers",
    "RenderSettings": "settings.settings",
    "Scene": "scene.description",
    "SceneError": "errors",
    "Session": "session",
    "SettingsError": "errors",
    "Tile": "observers",
    "description": "scene",
    "load_scene": "scene.archive",
    "save_scene": "scene.archive",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "description":
        return importlib.import_module(f"{__name__}.scene.description")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
