"""Opening a .blend, and what is said of a file that is none."""

from __future__ import annotations

import re
from pathlib import Path

from raybatch_addon.core.errors import SceneError

from .command import first_line

_BLENDS = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")  # plain, and packed by Zstandard or gzip
_POINTER = b"version https://git-lfs"


def unlike_blend(path: Path) -> str:
    """What is wrong with a file by its first bytes, and what to do about it, to be read behind its name; empty if it
    can be a .blend. Raises `OSError`.
    """
    with open(path, "rb") as opened:
        begun = opened.read(len(_POINTER))
    if begun.startswith(_POINTER):
        return "is a pointer of Git LFS, not the file: run `git lfs pull` in its repository"
    if not begun.startswith(_BLENDS):
        return "is not a .blend file: save it in Blender, or convert it there"
    return ""


def open_blend(path: Path) -> None:
    """Open a .blend in the Blender of this process, without the layout of its windows. Raises `SceneError`."""
    import bpy

    try:
        if why := unlike_blend(path):
            raise SceneError(f"{path} {why}")
        bpy.ops.wm.open_mainfile(filepath=str(path.absolute()), load_ui=False)
    except FileNotFoundError:
        raise SceneError(f"there is no file {path}: check the name") from None
    except IsADirectoryError:
        raise SceneError(f"{path} is a folder: name the .blend files in it") from None
    except OSError as error:
        raise SceneError(f"{path} cannot be read ({error.strerror}): check its permissions") from None
    except RuntimeError as error:
        why = re.sub(r"^Cannot read file .*?: ", "", first_line(error))  # its name is said already
        raise SceneError(f"{path} cannot be opened: {why}") from None
