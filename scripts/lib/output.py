"""Where render.py and others write: standard output kept clean, folders checked ahead, files written whole or not at
all.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.files import whole_file
from raybatch_addon.core.scene.notice import as_notice

if TYPE_CHECKING:
    from raybatch_addon.core.film import Film


class OutputError(RayBatchError):
    """A place that cannot be written."""


@contextlib.contextmanager
def own_standard_output(verbose: bool) -> Iterator[Any]:
    """Yield a text file that is the real standard output.

    Meanwhile what others print there, Blender's and Warp's native code included, goes to standard error
    if `verbose`, else nowhere.
    """
    sys.stdout.flush()
    real = os.dup(1)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        target = sys.stderr if verbose else nowhere
        os.dup2(2 if verbose else nowhere.fileno(), 1)
        try:
            with os.fdopen(os.dup(real), "w", encoding="utf-8") as file, contextlib.redirect_stdout(target):
                yield file
        finally:
            os.dup2(real, 1)
            os.close(real)


def leave(code: int) -> NoReturn:
    """End the process. Blender's module can hang while it takes itself down, long after the work is done: that is left
    out.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    if "bpy" in sys.modules:
        os._exit(code)
    sys.exit(code)


class OutputFolders:
    """Makes the folders of files to come and tries them out, before any time is spent on a render."""

    def __init__(self) -> None:
        self._made: list[Path] = []

    def prepare(self, path: Path) -> None:
        """Make sure that the file `path` can be written; raises `OutputError`."""
        if path.is_dir():
            raise OutputError(f"{path} cannot be written: it is a folder")
        missing = []
        folder = path.parent
        while not folder.exists():
            missing.append(folder)
            folder = folder.parent
        try:
            for each in reversed(missing):
                each.mkdir()
                self._made.append(each)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
            if path.exists() and not os.access(path, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror or error}") from None

    def take_back(self) -> None:
        """Remove the folders that were made and are still empty."""
        for folder in reversed(self._made):
            try:
                folder.rmdir()
            except OSError:
                return


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write(temporary path)` make a file, and put it at `path` when it is complete; raises `OutputError`."""
    try:
        with whole_file(path) as temporary:
            write(temporary)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from None


def write_text(path: Path, text: str) -> None:
    """Put `text` into the file `path`, whole or not at all; raises `OutputError`."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def numbered(path: str, number: int, many: bool) -> Path:
    """`path` with its last run of `#` replaced by the frame's number; with none, the number comes before the extension
    if there are many.
    """
    folder, name = os.path.split(path)
    if "#" not in name:
        if not many:
            return Path(path).absolute()
        stem, dot, extension = name.partition(".")
        name = f"{stem}####{dot}{extension}"
    end = name.rindex("#") + 1
    start = end
    while start > 0 and name[start - 1] == "#":
        start -= 1
    sign, digits = ("-" if number < 0 else ""), str(abs(number)).zfill(end - start)
    return (Path(folder) / f"{name[:start]}{sign}{digits}{name[end:]}").absolute()


def film_arrays(films: list[tuple[str, Film]]) -> dict[str, Any]:
    """The passes of the films of one frame, by view layer; those of the second on are called `layer/pass`, or
    `layer/view/pass` where there are several views.
    """
    arrays: dict[str, Any] = {}
    for number, (layer, film) in enumerate(films):
        for name, values in film.shown.items():
            arrays[name if number == 0 else f"{layer}/{name}"] = values
    return arrays


def write_film(path: Path, arrays: dict[str, Any]) -> None:
    """Write `arrays` by name, passes of films, to `path`, whole or not at all."""
    import numpy as np  # here alone: scripts that say that the environment is missing run without it

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)

    write_whole(path, write)


def write_json(target: str, statistics: list[dict[str, Any]], standard_output: IO[str]) -> None:
    """Write the statistics to the file `target`, or to standard output for `-`: one object, or a list when several were
    rendered.
    """
    text = json_text(statistics[0] if len(statistics) == 1 else statistics) + "\n"
    if target == "-":
        standard_output.write(text)
        standard_output.flush()
    else:
        write_text(Path(target).absolute(), text)


def write_report(target: str | None, report: dict[str, Any], text: str, standard_output: IO[str]) -> None:
    """Write `report` to the file `target`, if one is given, and `text` to standard output; with `-` the report alone is
    written there.
    """
    if target:
        write_json(target, [report], standard_output)
    if target != "-":
        standard_output.write(text + "\n")


# Lists of numbers as `json` indents them: text never holds a line's end as it is
_NUMBERS = re.compile(r'\[\n[^\[\]{}"]*\]')
LINE_MOST = 120  # characters of a list on one line


def json_text(value: Any) -> str:
    """`value` as JSON to be read by people: an entry a line, and short lists of numbers on one."""

    def on_one_line(found: re.Match) -> str:
        line = f"[{' '.join(found[0][1:-1].split())}]"
        return line if len(line) <= LINE_MOST else found[0]

    return _NUMBERS.sub(on_one_line, json.dumps(value, indent=2, ensure_ascii=False))


# What people look for comes before the rest, and what is long behind it
_FIRST = (
    "engine",
    "warnings",
    "missing",
    "auto",
    "device",
    "frame",
    "seconds",
    "samples",
    "rays",
    "rays_per_second",
    "complete",
)
_LAST = ("batching", "counters", "settings", "left_out", "modules", "versions")


def _place(name: str) -> int:
    return _FIRST.index(name) - len(_FIRST) if name in _FIRST else _LAST.index(name) + 1 if name in _LAST else 0


def described(film: Film, frame_number: int | None, view_layer: str | None) -> dict[str, Any]:
    """The film's statistics with what picture they are of."""
    statistics = dict(film.statistics)
    statistics["frame"] = {**statistics.get("frame", {}), "number": frame_number, "view_layer": view_layer}
    return {name: statistics[name] for name in sorted(statistics, key=_place)}


WARNINGS_SHOWN = 10  # of one picture; all of them are in the statistics


def print_warnings(warnings: Iterable[str], script: str = "render.py") -> None:
    """Write what a render of `script` did without, or did otherwise, to standard error. Options that would mend it are
    those of render.py.
    """
    warnings = list(warnings)
    for text in warnings[:WARNINGS_SHOWN]:
        notice = as_notice(text)
        remedy = notice.to_do() if script == "render.py" else notice.remedy
        print(f"{script}: warning: {text}{f' ({remedy})' if remedy else ''}", file=sys.stderr)
    if len(warnings) > WARNINGS_SHOWN:
        print(f"{script}: warning: {len(warnings) - WARNINGS_SHOWN} more; --json lists them", file=sys.stderr)


def print_notes(texts: Iterable[str], script: str = "render.py") -> None:
    """Write what `script` did beside what was said, to standard error."""
    for text in texts:
        print(f"{script}: {text}", file=sys.stderr)


def print_saved(path: Path, what: str = "") -> None:
    """Write where a picture went, and what it shows, to standard error."""
    print(f"render.py: saved {path}{f' ({what})' if what else ''}", file=sys.stderr)
