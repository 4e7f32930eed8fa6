"""Which worker goes on with which tile. Pure policy, without a device of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Hashable, Iterable
from typing import Generic, TypeVar

Work = TypeVar("Work")

# A tile that is near is taken if it takes such a share of the time that the longest of all takes. With 0.9 eight
# devices would end 0.1 to 0.3 % sooner, but move three times as many tiles (simulated)
NEAR_LONGEST = 0.5


class Deal(Generic[Work]):
    """Tiles that wait for workers, dealt to whoever is free: those that take longest first, equal ones in order.
    Workers have places, such as the devices whose memory they share: one takes a tile that is at its place or nowhere
    yet, if it takes `NEAR_LONGEST` of the time that the longest of all takes, and else that.
    """

    def __init__(self, waiting: Iterable[tuple[Work, Hashable, float]]):
        """`waiting`: each with its place (None: nowhere yet) and how long it takes [s] (inf: that is not known)."""
        self._waiting = list(waiting)
        self._lock = threading.Lock()

    def take(self, place: Hashable) -> Work | None:
        """The next one for a worker at `place`; None where all are taken."""
        with self._lock:
            if not self._waiting:
                return None
            seconds = [each for _, _, each in self._waiting]
            near = [i for i, (_, its, _) in enumerate(self._waiting) if its is None or its == place]
            at = max(range(len(seconds)), key=seconds.__getitem__)
            nearest = max(near, key=seconds.__getitem__, default=at)
            return self._waiting.pop(nearest if seconds[nearest] >= NEAR_LONGEST * seconds[at] else at)[0]

    def put_back(self, work: Work, place: Hashable, seconds: float = math.inf) -> None:
        """It waits again behind those that take as long, now at `place`; what is left of it takes `seconds`."""
        with self._lock:
            self._waiting.append((work, place, seconds))
