"""Documents with parts that scripts make: each stands between two lines, its marks."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

from lib.output import write_text

WIDTH = 120  # columns of a document


def with_part(text: str, first: str, last: str, made: str, where: object) -> str:
    """`text` with `made` between the lines `first` and `last`; raises `ValueError`, which names `where`, if they are
    not there once.
    """
    text, found = re.subn(
        re.escape(first) + ".*?" + re.escape(last), lambda _: f"{first}\n\n{made}\n\n{last}", text, flags=re.S
    )
    if found != 1:
        raise ValueError(f"{where} must hold the line {first}, and the line {last} behind it, once")
    return text


def wrapped(text: str, first: str = "", others: str = "") -> list[str]:
    """`text` in lines of a document that break between words, with `first` before the first of them and `others` before
    the others.
    """
    return textwrap.wrap(
        text, WIDTH, initial_indent=first, subsequent_indent=others, break_long_words=False, break_on_hyphens=False
    )


def list_item(text: str, indent: str = "") -> list[str]:
    """`text` as an item of a list, in lines."""
    return wrapped(text, f"{indent}- ", f"{indent}  ")


def write_or_check(page: Path, updated: Callable[[str], str], script: str, arguments: list[str]) -> int:
    """Write `page` as `updated` makes it of its text; with --check among `arguments` nothing is written. The exit code:
    1 where the page was checked and is not up to date, with a line on standard error that says to run `script`.
    """
    text = page.read_text(encoding="utf-8")
    new = updated(text)
    if "--check" not in arguments:
        write_text(page, new)
        return 0
    if new != text:
        print(f"{page} is not up to date: run python {script}", file=sys.stderr)
    return int(new != text)
