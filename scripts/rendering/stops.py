"""Stops by Ctrl-C and SIGTERM: the first ends a render with what is done, the second ends the process."""

from __future__ import annotations

import signal
import time
from typing import Any

# A signal that comes so soon after the first is the same: a process may get it twice, once with its group [s]
SAME_SECONDS = 1.0
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequests:
    """Inside, signals that ask for an end are remembered instead of raised; a second one is a `KeyboardInterrupt`."""

    def __init__(self) -> None:
        self._asked_at: float | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopRequests:
        for each in _SIGNALS:
            self._before[each] = signal.signal(each, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def asked(self) -> bool:
        """Whether the render is to end."""
        return self._asked_at is not None

    def _on_signal(self, *_: object) -> None:
        now = time.monotonic()
        if self._asked_at is None:
            self._asked_at = now
        elif now - self._asked_at > SAME_SECONDS:
            raise KeyboardInterrupt
