"""Documents with parts that scripts make: each stands between two lines, its marks."""

from __future__ import annotations

import re


def with_part(text: str, first: str, last: str, made: str, where: object) -> str:
    """`text` with `made` between the lines `first` and `last`; raises `ValueError`, which names `where`, if they are not there once."""
    text, found = re.subn(re.escape(first) + ".*?" + re.escape(last), lambda _: f"{first}\n\n{made}\n\n{last}", text, flags=re.S)
    if found != 1:
        raise ValueError(f"{where} must hold the line {first}, and the line {last} behind it, once")
    return text
