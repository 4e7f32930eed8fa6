"""Write the tables of rooms and files in docs/architecture.md: python scripts/tables/architecture_table.py [--check]

A room's idea is the first sentence of its `__init__.py`, a file's that of its own docstring (in a native header of its
first comment). With --check nothing is written, and the exit code is 1 where the page is not up to date.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from tables.marked_text import list_item, with_part, write_or_check
from tests.test_architecture import PACKAGE, room_of

MANUAL = ROOT / "docs/architecture.md"
PARTS = ("rooms", "files")  # the marks' names, in the order in which they are written
_COMMAND = re.compile(r": python scripts/.*")  # how a script is called, behind what it does
_SENTENCE = re.compile(r".*?[.!?](?=\s+[A-Z`*]|$)")  # the first one of a line of text


def _marks(part: str) -> tuple[str, str]:
    return f"<!-- {part}: made by scripts/tables/architecture_table.py -->", f"<!-- end of {part} -->"


def first_sentence(text: str) -> str:
    """The first sentence of the first paragraph of `text`, in one line; empty where there is none."""
    paragraph = " ".join(text.strip().split("\n\n")[0].split())
    found = _SENTENCE.match(paragraph)
    return found.group() if found else paragraph


def idea_of(path: Path) -> str:
    """What the Python file or native header at `path` is, in one sentence; raises `ValueError` if it does not say."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".h":
        comment = re.match(r"(?:[ \t]*//[^\n]*\n)+", text)
        about = re.sub(r"(?m)^[ \t]*//[ \t]?", "", comment.group()) if comment else ""
    else:
        about = ast.get_docstring(ast.parse(text, str(path))) or ""
    sentence = _COMMAND.sub(".", first_sentence(about))
    if not sentence:
        raise ValueError(f"{path} does not say what it is: begin it with a sentence")
    return sentence


def rooms() -> list[Path]:
    """Folders of the package in the order of their imports: each imports only from those before it."""
    folders = {path.parent for path in PACKAGE.rglob("__init__.py")}
    return sorted(folders, key=lambda folder: (room_of(folder / "__init__.py"), folder))


def script_rooms() -> list[Path]:
    """Folders of scripts/, which hold the parts of its commands."""
    return sorted(path.parent for path in (ROOT / "scripts").rglob("__init__.py"))


def _name(folder: Path) -> str:
    """`core/bvh/` of a folder of the package, `scripts/tables/` of one beside it."""
    inside = folder == PACKAGE or PACKAGE in folder.parents
    name = folder.relative_to(PACKAGE if inside else ROOT).as_posix()
    return f"{PACKAGE.name}/" if name == "." else f"{name}/"


def _files(folder: Path) -> list[Path]:
    """Files of code of a room: those in `folder`, and headers in its folders that are no rooms of their own."""
    found = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
    headers = [path for path in folder.rglob("*.h") if _room(path) == folder]
    return sorted(found) + sorted(headers)


def _room(path: Path) -> Path:
    """The nearest folder above `path` that has an `__init__.py`."""
    return next(folder for folder in path.parents if (folder / "__init__.py").exists())


def rooms_table() -> str:
    """A row for each folder of the package."""
    lines = ["| room | idea |", "|---|---|"]
    for folder in rooms():
        idea = idea_of(folder / "__init__.py").replace("|", "\\|")
        lines.append(f"| `{_name(folder)}` | {idea} |")
    return "\n".join(lines)


def _folded(folder: Path) -> list[str]:
    """The list of the files of `folder`, which unfolds under its name."""
    lines = [f"<details><summary><code>{_name(folder)}</code></summary>", ""]
    for path in _files(folder):
        lines += list_item(f"`{path.relative_to(folder).as_posix()}`: {idea_of(path)}")
    return [*lines, "", "</details>"]


def files_list() -> str:
    """A list for each folder of the package that holds files, the commands, and the folders of their parts."""
    folders = [folder for folder in rooms() if _files(folder)] + [ROOT / "scripts", *script_rooms()]
    return "\n".join(line for folder in folders for line in _folded(folder))


def updated(text: str) -> str:
    """The page `text` with both parts as they are now; raises `ValueError` where a mark is missing."""
    for part, made in zip(PARTS, (rooms_table(), files_list()), strict=True):
        text = with_part(text, *_marks(part), made, MANUAL)
    return text


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(MANUAL, updated, "scripts/tables/architecture_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
