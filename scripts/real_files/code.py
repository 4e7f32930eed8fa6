"""The code that pictures are rendered by: those of other code are rendered again, and never mixed up with newer ones
unsaid.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
from collections.abc import Iterable
from pathlib import Path

import raybatch_addon

_OURS = ("RayBatch", "Warp")  # what Cycles does not depend on
_SCRIPTS = Path(__file__).resolve().parents[1]
# What opens a file, prepares it for an engine and renders it
_PREPARING = (
    "real_files/opened.py",
    "real_files/sheets.py",
    "real_files/sources.py",
    "real_files/worker.py",
    "lib/cycles_peer.py",
)


@functools.cache
def code_of(engine: str) -> dict[str, str]:
    """Digests of code and versions of packages that the pictures of `engine` follow from, by name; “none” for a package
    that is not installed.
    """
    addon = Path(raybatch_addon.__file__).parent
    found = {
        "RayBatch": _digest(addon, (each for each in addon.rglob("*") if each.suffix in (".py", ".h", ".npz"))),
        "preparation": _digest(_SCRIPTS, (_SCRIPTS / name for name in _PREPARING)),
        "bpy": _package_version("bpy"),
        "Warp": _package_version("warp-lang"),
    }
    return found if engine == "RAYBATCH" else {name: each for name, each in found.items() if name not in _OURS}


def what_changed(then: dict[str, str] | None, now: dict[str, str]) -> str:
    """What of the code `now` was otherwise `then` (None: nobody wrote it down), in words."""
    if then is None:
        return "code that was not written down"
    names = [name for name in now if then.get(name) != now[name]]
    return f"other code ({', '.join(f'{name} {then.get(name)}, now {now[name]}' for name in names)})"


def _digest(folder: Path, files: Iterable[Path]) -> str:
    made = hashlib.blake2b(digest_size=4)
    for path in sorted(files):
        content = path.read_bytes()
        made.update(f"{path.relative_to(folder).as_posix()} {len(content)}\n".encode() + content)
    return made.hexdigest()


def _package_version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:  # such as Blender's own Python
        return "none"
