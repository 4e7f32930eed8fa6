"""The documents name files that are there, and their links lead somewhere."""

import re
from pathlib import Path

import pytest

from tests.support.command_line import ROOT

DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
# Folders that paths in documents are relative to
BASES = (ROOT, ROOT / "raybatch_addon", ROOT / "raybatch_addon/core")
_MADE = re.compile(r"<!-- [\w-]+: made by .*?<!-- end of [^>]*-->", re.DOTALL)
_PATH = re.compile(r"`((?:[\w.*]+/)+[\w.*]+\.(?:py|h|npz|md))`")
_LINK = re.compile(r"\]\(([^)#\s]+)?(#[^)\s]+)?\)")
_EXAMPLES = ("NAME", "out/")  # stand for files that a reader makes


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def anchors(text: str) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {"#" + re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_files_that_are_named_are_there(document):
    text = _MADE.sub("", document.read_text(encoding="utf-8"))
    for path in _PATH.findall(text):
        if not any(part in path for part in _EXAMPLES):
            assert any(list(base.glob(path)) for base in BASES), f"{name_of(document)} names {path}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_to_files_and_headings(document):
    for path, anchor in _LINK.findall(document.read_text(encoding="utf-8")):
        if path.startswith("http"):
            continue
        target = document.parent / path if path else document
        assert target.exists(), f"{name_of(document)} links {path}"
        if anchor:
            assert anchor in anchors(target.read_text(encoding="utf-8")), f"{name_of(document)} links {path}{anchor}"
