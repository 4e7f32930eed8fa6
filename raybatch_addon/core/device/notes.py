"""What the user is told of compiled kernels: notes for the next render's report, and that some are being compiled."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

_lock = threading.Lock()
_compiling = 0
_notes: list[str] = []
_noted: set[str] = set()


def note(text: str) -> None:
    """Have the next report name `text`; the same text is reported once."""
    with _lock:
        if text not in _noted:
            _noted.add(text)
            _notes.append(text)


def take_notes() -> list[str]:
    """What was noted since the last time."""
    with _lock:
        taken = list(_notes)
        _notes.clear()
    return taken


@contextlib.contextmanager
def compiling_noted() -> Iterator[None]:
    """Inside, this thread compiles kernels."""
    global _compiling
    with _lock:
        _compiling += 1
    try:
        yield
    finally:
        with _lock:
            _compiling -= 1


def is_any_compiled() -> bool:
    """Whether threads of this process compile kernels, or wait for compilers."""
    return _compiling > 0
