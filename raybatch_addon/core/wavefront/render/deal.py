"""Which worker goes on with which tile. Pure policy, without a device of its own."""

from __future__ import annotations

import threading
from collections.abc import Hashable, Iterable
from typing import Generic, TypeVar

Work = TypeVar("Work")


class Deal(Generic[Work]):
    """Tiles that wait for workers, dealt in order to whoever is free. Workers have places, such as the devices whose
    memory they share: one takes the first tile that is at its place or nowhere yet, and one of another place's where
    none is left.
    """

    def __init__(self, waiting: Iterable[tuple[Work, Hashable]]):
        """`waiting`: each with its place; None: nowhere yet."""
        self._waiting = list(waiting)
        self._lock = threading.Lock()

    def take(self, place: Hashable) -> Work | None:
        """The next one for a worker at `place`; None where all are taken."""
        with self._lock:
            if not self._waiting:
                return None
            at = next((i for i, (_, its) in enumerate(self._waiting) if its is None or its == place), 0)
            return self._waiting.pop(at)[0]

    def put_back(self, work: Work, place: Hashable) -> None:
        """It waits again behind the others, now at `place`."""
        with self._lock:
            self._waiting.append((work, place))
