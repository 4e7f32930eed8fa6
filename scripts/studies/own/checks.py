"""Checks that definitions have in common: a key at a time, with errors that name the file, the key, and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lib.command import UsageError


class Checks:
    """Checks values of one definition."""

    def __init__(self, where: str, folder: Path):
        """`where` begins messages, and files are relative to `folder`."""
        self.where, self.folder = where, folder

    def error(self, key: str, what: str) -> UsageError:
        """What is wrong with the value of `key`; empty: with all of it."""
        return UsageError(f"{self.where}: {key}: {what}" if key else f"{self.where}: {what}")

    def known(self, key: str, values: Any, keys: Iterable[str]) -> None:
        """Raise `UsageError` where `values` is no table, or has a key that is none of `keys`."""
        if not isinstance(values, dict):
            raise self.error(key, f"this is no table but {values!r}")
        for name in values:
            if name not in keys:
                raise self.error(key, self.unknown("key", name, keys))

    def unknown(self, what: str, name: Any, names: Iterable[str]) -> str:
        """The words for a name that is none of `names`, with the closest one."""
        close = difflib.get_close_matches(str(name), list(names), n=1)
        hint = f"did you mean {close[0]}?" if close else f"they are {', '.join(names)}"
        return f"there is no {what} {name!r}; {hint}"

    def text(self, key: str, value: Any) -> str:
        """A text on one line; only the sentence `about` may be empty."""
        if not isinstance(value, str) or "\n" in value or not (value.strip() or key == "about"):
            raise self.error(key, f"{value!r} is not valid: write a text on one line, in quotes")
        return value.strip()

    def whole(self, key: str, value: Any, least: int, most: int) -> int:
        """A whole number from `least` to `most`."""
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.error(key, f"{value!r} is not valid: write a whole number, {least} to {most:,}")
        return value

    def entries(self, key: str, value: Any, of_what: str) -> list[Any]:
        """A list that is not empty, and has nothing twice."""
        if not isinstance(value, list) or not value:
            raise self.error(key, f"{value!r} is not valid: write a list of {of_what}, in brackets")
        for i, each in enumerate(value):
            if each in value[:i]:
                raise self.error(key, f"{each!r} is there twice: leave one out")
        return value
