"""Where compiled kernels are kept, so that Blender and the scripts find each other's.

Kernels are cached by their content, so what one Blender, Python or script compiled serves every other one.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

VARIABLE = "RAYBATCH_KERNEL_CACHE"  # environment variable that overrides every other choice
EXTENSION_ID = "raybatch"


def kernel_cache_folder() -> Path:
    """The folder for compiled kernels; it need not exist yet.

    Inside Blender's extension it is the extension's own folder of the user. Elsewhere it is that same folder of the
    newest Blender in which the extension is installed, so that `render.py --prewarm` warms it; and where it is
    not installed, the user's cache folder.
    """
    if override := os.environ.get(VARIABLE):
        return Path(override).expanduser().absolute()
    package = (__package__ or "").rpartition(".")[0]  # the add-on, of which this folder is a part
    if package.startswith("bl_ext."):
        import bpy

        return Path(bpy.utils.extension_path_user(package, path="kernels"))
    installed = sorted(_installed_extensions(), key=_blender_version)
    if installed:
        return installed[-1] / "kernels"
    return user_cache_folder() / "raybatch" / "kernels"


def _installed_extensions() -> list[Path]:
    """The user folders of the installed extension, over all Blender versions and repositories."""
    found = []
    for extensions in _extension_folders():
        for code in extensions.glob(f"*/{EXTENSION_ID}/blender_manifest.toml"):
            repository = code.parent.parent.name
            found.append(extensions / ".user" / repository / EXTENSION_ID)
    return found


def _extension_folders() -> list[Path]:
    """Every `extensions` folder of the user that Blender would look at."""
    if folder := os.environ.get("BLENDER_USER_EXTENSIONS"):
        return [Path(folder)]
    if folder := os.environ.get("BLENDER_USER_RESOURCES"):
        return [Path(folder) / "extensions"]
    if sys.platform == "win32":
        root = Path(os.environ.get("APPDATA", Path.home())) / "Blender Foundation" / "Blender"
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Application Support" / "Blender"
    else:
        root = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "blender"
    return list(root.glob("*/extensions"))


def _blender_version(user_folder: Path) -> list[int]:
    """The version in `.../5.2/extensions/.user/repository/raybatch`, for sorting."""
    parts = user_folder.parents[3].name.split(".") if len(user_folder.parents) > 3 else []
    return [int(part) for part in parts if part.isdigit()]


def user_cache_folder() -> Path:
    """Where the system wants programs to keep what they can make again; it need not exist yet."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
