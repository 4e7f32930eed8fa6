"""Files that are written while the next picture is rendered."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

# Files that wait or are being written: more of them would hold the memory of more pictures than are rendered meanwhile
WAITING_MOST = 2


class BackgroundWriter:
    """Writes one file after another on a thread of its own."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "writer")
        self._waiting: deque[Future] = deque()

    def write(self, job: Callable[[], object]) -> None:
        """Have `job()` called soon; waits while `WAITING_MOST` others are not done. Raises what an earlier one raised,
        and then writes this one too.
        """
        self._waiting.append(self._thread.submit(job))
        while self._waiting and (self._waiting[0].done() or len(self._waiting) > WAITING_MOST):
            wait([self._waiting[0]])  # which an interrupt may end
            self._waiting.popleft().result()

    def close(self) -> BaseException | None:
        """Wait until all is written; the first error that nobody was told of."""
        self._thread.shutdown()
        errors = [error for each in self._waiting if (error := each.exception()) is not None]
        self._waiting.clear()
        return errors[0] if errors else None
