"""Ctrl-C and SIGTERM while modules are imported: Blender crashes where an import is broken off."""

from __future__ import annotations

import signal
import threading
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class HeldSignals:
    """From its making on signals that ask for an end are remembered, until they are released; on the main thread."""

    def __init__(self) -> None:
        self._asked = False
        self._before: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            for each in _SIGNALS:
                if signal.getsignal(each) not in (signal.SIG_IGN, None):  # else nobody asks for an end by it
                    self._before[each] = signal.signal(each, self._note)

    def release(self) -> None:
        """Signals are as before; raises `KeyboardInterrupt` if one came."""
        while self._before:
            signal.signal(*self._before.popitem())
        if self._asked:
            raise KeyboardInterrupt

    def __enter__(self) -> HeldSignals:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _note(self, *_: object) -> None:
        self._asked = True
