"""Where Open Image Denoise lies beside Blender, which brings it along."""

from __future__ import annotations

import functools
import sys
from importlib.util import find_spec
from pathlib import Path

from ..core.denoise.library import DenoiseLibrary, open_library
from ..core.errors import RayBatchError
from ..core.settings.settings import RenderSettings

# Folders of shared libraries beside Blender's program or module
_FOLDERS = ("lib", "blender.shared", "../Resources/lib", ".")


def library_places() -> list[Path]:
    """Folders in which Blender may have the library; also those of a module `bpy` that is there and not imported."""
    module = sys.modules.get("bpy")
    program = getattr(getattr(module, "app", None), "binary_path", "")
    spec = find_spec("bpy") if module is None else module.__spec__
    homes = [Path(program).parent] if program else []
    if spec is not None and spec.origin and Path(spec.origin).is_file():
        homes.append(Path(spec.origin).parent)
    return [home / folder for home in homes for folder in _FOLDERS]


def library_for(settings: RenderSettings) -> DenoiseLibrary | None:
    """The library that `settings` need, None where they do not denoise; raises `RayBatchError` where it is missing."""
    return open_library(settings.denoise_library, library_places()) if settings.denoise == "ON" else None


@functools.cache
def why_not(given: str) -> str:
    """Why renders cannot be denoised with the library that is `given` in the settings; empty where they can."""
    try:
        open_library(given, library_places())
    except RayBatchError as error:
        return str(error)
    return ""
