"""The manual quotes messages that there are, and shows pictures that are not large."""

import ast
import re
from functools import cache

import pytest

from tests.support.command_line import ROOT

MANUAL = ROOT / "docs/manual"
WALK = ROOT / "scripts/testing/window/walk.py"
PICTURE_BYTES = 150_000
_GAP = "…"  # what stands for names and numbers in messages


@cache
def messages():
    """The texts in the add-on's code, each on one line, with a mark for what is put in when it runs."""
    found = set()
    for path in (ROOT / "raybatch_addon").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                found.add("".join(each.value if isinstance(each, ast.Constant) else _GAP for each in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(re.sub(r"\{\w+\}", _GAP, node.value))
    return found


def is_a_message(quoted, there):
    """Whether some text has all pieces of `quoted` in their order."""
    pieces = [re.escape(piece.strip()) for piece in quoted.split(_GAP) if piece.strip(" :;,.()")]
    pattern = re.compile(".*".join(pieces))
    return any(pattern.search(text) for text in there)


def quoted_messages():
    text = (MANUAL / "troubleshooting.md").read_text(encoding="utf-8")
    return [found[1] for found in re.finditer(r"^\| `([^`]*)`", text, re.MULTILINE)]


@pytest.mark.parametrize("quoted", quoted_messages())
def test_messages_of_the_manual_are_those_of_the_code(quoted):
    assert is_a_message(quoted, messages()), f"no text of the add-on reads {quoted!r}"


def test_a_message_that_is_not_there_is_found():
    assert len(quoted_messages()) > 30
    assert not is_a_message("the camera is out of … film", messages())


def test_pictures_are_shown_and_small():
    pictures = {path.name: path for path in (MANUAL / "images").iterdir()}
    text = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md"))
    assert pictures and [name for name in pictures if f"images/{name})" not in text] == []
    assert [name for name, path in pictures.items() if path.stat().st_size > PICTURE_BYTES] == []


def taken_pictures():
    """The names of pictures in `walk.py`, which takes them: first arguments of `take`, `take_tab`, and its panels."""
    names = set()
    for node in ast.walk(ast.parse(WALK.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("take", "take_tab")
        ):
            if isinstance(node.args[0], ast.Constant):
                names.add(node.args[0].value)
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PANELS":
            names |= {f"panel-{name.replace('_', '-')}" for name in ast.literal_eval(node.value)}
    return names


def test_the_walk_takes_each_picture_of_the_manual():
    assert taken_pictures() == {path.stem for path in (MANUAL / "images").iterdir()}
