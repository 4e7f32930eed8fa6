"""Notes about compiled kernels for the user, kept for the next render's report."""

from __future__ import annotations

import threading

_lock = threading.Lock()
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
