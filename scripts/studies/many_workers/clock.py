"""Time of a simulation: what happens next, in order, and who serves one after another."""

from __future__ import annotations

import heapq
from collections.abc import Callable

Work = Callable[[], None]


class Clock:
    """Events in the order of their times; those of one time in the order in which they were asked for."""

    def __init__(self) -> None:
        self.now = 0.0  # [s]
        self._events: list[tuple[float, int, Work]] = []
        self._count = 0

    def at(self, seconds: float, work: Work) -> None:
        """Do `work` at that time, which is not before now."""
        self._count += 1
        heapq.heappush(self._events, (max(seconds, self.now), self._count, work))

    def after(self, seconds: float, work: Work) -> None:
        """Do `work` so much later."""
        self.at(self.now + seconds, work)

    def run(self, is_over: Callable[[], bool] = lambda: False) -> None:
        """Until nothing is left to do, or `is_over()`."""
        while self._events and not is_over():
            self.now, _, work = heapq.heappop(self._events)
            work()


class Line:
    """Serves one after another, in the order in which they ask."""

    def __init__(self, clock: Clock):
        self._clock, self.free_at, self.busy = clock, 0.0, 0.0  # [s]

    def serve(self, seconds: float, then: Work) -> None:
        """So long, once all before are served; and then `then`."""
        self.free_at = max(self.free_at, self._clock.now) + seconds
        self.busy += seconds
        self._clock.at(self.free_at, then)


class Port:
    """What connects a machine: bytes go out and come in at a rate, one transfer after another each way."""

    def __init__(self, clock: Clock, rate: float):
        """`rate` [bytes/s]."""
        self.out, self.into, self.rate = Line(clock), Line(clock), rate


def transfer(clock: Clock, source: Port, target: Port, size: float, latency: float, then: Work) -> None:
    """`size` bytes go from `source` to `target`, which are both taken for it; within a machine they take no time."""
    if source is target:
        clock.after(latency, then)
        return
    begin = max(clock.now, source.out.free_at, target.into.free_at)
    seconds = size / min(source.rate, target.rate)
    for line in (source.out, target.into):
        line.free_at, line.busy = begin + seconds, line.busy + seconds
    clock.at(begin + seconds + latency, then)
