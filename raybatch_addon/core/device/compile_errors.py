"""Errors of compilers, reported for the feature whose code they are about; all that a compiler wrote goes to a file."""

from __future__ import annotations

import contextlib
import re
import tempfile
import traceback
from pathlib import Path

import warp as wp

from .compiler import CompileError

_PACKAGE = Path(__file__).resolve().parents[2]
# The place of an error and, below it, the line of code as the compiler shows it
_ERROR = re.compile(r"^(.+?):(\d+):\d+: (?:fatal )?error: .*\n(?: *\d+ \| (.*))?", re.MULTILINE)
_MARK = re.compile(r'#line 1 "(.+)"')  # of native code: lines below it have its name, and are counted from it
_PLACE = re.compile(r"([^\s\"']+\.py):(\d+)")
_NATIVE = "raybatch native: "
# Features by the folder of their code: the first that fits; {} is the file's name
_FEATURES = {
    "core/programs/ops/closures": "shader nodes of closures ({})",
    "core/programs/ops": "shader nodes ({})",
    "core/programs": "shader programs ({})",
    "core/shading/bsdf": "closures ({})",
    "core/shading/lights": "lights ({})",
    "core/shading": "shading ({})",
    "core/sky": "the sky ({})",
    "core/bvh": "the tree ({})",
    "core/film": "the film ({})",
    "core/wavefront": "the stage {}",
    "core/native": "native code ({})",
}


def complaint_of(module: wp.Module, device: wp.Device, error: Exception, source: Path, folder: Path) -> str:
    """The line for a user: which feature could not be compiled, why, and where the log is.

    Args:
        source: what was compiled, if it got so far.
        folder: where the log goes, if it can be written; else to the system's temporary folder.
    """
    log = error.log if isinstance(error, CompileError) else "".join(traceback.format_exception(error))
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    cause = (lines[0] if isinstance(error, CompileError) else lines[-1]) if lines else type(error).__name__
    kernel = re.sub(r"__locals__|_[0-9a-f]{8}$", " ", module.name).strip()
    place = _place_in_source(log, source) or _place_in(log)
    what = _feature(*place) if place else f"the kernel {kernel}"
    where = _write_log(f"{module.name} for {device.alias}\n{what}: {cause}\n\n{log}", module.name, folder)
    return f"{what} could not be compiled for {device.alias}: {cause.rstrip('.')}; {where}"


def _place_in_source(log: str, source: Path) -> tuple[str, int] | None:
    """The file and line of Python whose code a compiler of C++ complains of: Warp writes them above each function."""
    try:
        lines = source.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    for name, number, shown in _ERROR.findall(log):
        header = _PACKAGE / "core" / "native" / name.removeprefix(_NATIVE)
        if name.startswith(_NATIVE) and header.exists():
            return str(header), int(number)
        starts = [0] if name.endswith(".cpp") else []
        starts += [i + 1 for i, line in enumerate(lines) if (mark := _MARK.match(line)) and mark[1] == name]
        ends = [start + int(number) for start in starts if start + int(number) <= len(lines)]
        ends.sort(key=lambda end: lines[end - 1].strip() == shown.strip())  # two pieces may have one name
        for line in reversed(lines[: ends[-1]] if ends else []):
            if line.startswith("// ") and (place := _place_in(line)):
                return place
    return None


def _place_in(text: str) -> tuple[str, int] | None:
    """The last place of this package that `text` names."""
    found = [(path, int(line)) for path, line in _PLACE.findall(text) if Path(path).is_relative_to(_PACKAGE)]
    return found[-1] if found else None


def _feature(path: str, line: int) -> str:
    place = Path(path).relative_to(_PACKAGE)
    for folder, words in _FEATURES.items():
        if place.is_relative_to(folder):
            return f"{words.format(place.stem)}, {place.as_posix()}:{line},"
    return f"{place.as_posix()}:{line}"


def _write_log(text: str, name: str, folder: Path) -> str:
    for each in (folder / "failed", Path(tempfile.gettempdir())):
        with contextlib.suppress(OSError):
            each.mkdir(parents=True, exist_ok=True)
            path = each / f"{name}.log"
            path.write_text(text, encoding="utf-8")
            return f"the log is {path}"
    return "there was no room for a log"
