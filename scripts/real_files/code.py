"""The code that pictures are rendered by: those of other code are rendered again, and never mixed up with newer ones
unsaid.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from lib.command import UsageError

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
_unpacked: Path | None = None  # the add-on of an extension, which renders in the place of the clone's


@contextlib.contextmanager
def of_extension(extension: Path | None, script: Path) -> Iterator[Path]:
    """The copy of `script`, of this folder's parent, whose processes render by the add-on in the zip `extension`, with
    the kernels that are shipped in it; `script` itself without one. Raises `UsageError` for what is no such zip.
    """
    global _unpacked
    if extension is None:
        yield script
        return
    with tempfile.TemporaryDirectory(prefix="raybatch-extension-") as folder:
        addon = Path(folder) / raybatch_addon.__name__
        try:
            with zipfile.ZipFile(extension) as packed:
                packed.extractall(addon)
        except (OSError, zipfile.BadZipFile) as error:
            raise UsageError(f"--extension {extension} cannot be unpacked: {error}") from None
        if not (addon / "__init__.py").is_file() or not (addon / "core").is_dir():
            raise UsageError(f"--extension {extension} is no zip of RayBatch: scripts/package.py makes one")
        # scripts import the add-on that lies beside their folder
        scripts = shutil.copytree(_SCRIPTS, Path(folder) / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
        _unpacked = addon
        code_of.cache_clear()
        try:
            yield scripts / script.name
        finally:
            _unpacked = None
            code_of.cache_clear()


def addon_folder() -> Path:
    """The add-on that renders."""
    return _unpacked or Path(raybatch_addon.__file__).parent


@functools.cache
def code_of(engine: str) -> dict[str, str]:
    """Digests of code and versions of packages that the pictures of `engine` follow from, by name; “none” for a package
    that is not installed.
    """
    addon = addon_folder()
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
