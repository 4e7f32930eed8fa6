"""How long the work of a device takes, measured without making the host wait for it."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import warp as wp

# Parts of a render that are timed
STAGES = ("generate", "lists", "sort", "queue", "top level", "treelet", "trace", "copy", "shade", "film", "transfer")
# Intervals under way at most on a device; at more the oldest is waited for
PENDING_MAX = 1024
# Every so many intervals those that are over are read
_READ_EVERY = 64

Tag = TypeVar("Tag", bound=Hashable)


class Clock(Protocol):
    """Marks points in the work of a device."""

    def mark(self) -> Any:
        """The point after all work that the device was given so far."""

    def is_past(self, mark: Any) -> bool:
        """Whether the device has come to `mark`."""

    def seconds(self, start: Any, end: Any) -> float:
        """Time between two marks; waits until the device has come to `end` [s]."""

    def release(self, mark: Any) -> None:
        """`mark` is needed no more."""


class HostClock:
    """The clock of the CPU, where a launch returns when its work is done."""

    def __init__(self, now: Callable[[], float] = time.perf_counter):
        """`now` gives the time [s]."""
        self._now = now

    def mark(self) -> float:
        """Now [s]."""
        return self._now()

    def is_past(self, mark: float) -> bool:
        """Always."""
        return True

    def seconds(self, start: float, end: float) -> float:
        """The difference."""
        return end - start

    def release(self, mark: float) -> None:
        """Nothing is held."""


class CudaClock:
    """Events on the stream of a CUDA device; resolution 0.5 microseconds."""

    def __init__(self, device: wp.Device):
        self._device = device
        self._free: list[wp.Event] = []

    def mark(self) -> wp.Event:
        """An event behind everything on the stream."""
        event = self._free.pop() if self._free else wp.Event(self._device, enable_timing=True)
        return self._device.stream.record_event(event)

    def is_past(self, mark: wp.Event) -> bool:
        """Whether the event has come about."""
        return mark.is_complete

    def seconds(self, start: wp.Event, end: wp.Event) -> float:
        """Time between the events [s]."""
        return wp.get_event_elapsed_time(start, end) * 1e-3

    def release(self, mark: wp.Event) -> None:
        """The event will mark another point."""
        self._free.append(mark)


def clock_of(device: wp.Device) -> Clock:
    """The clock that belongs to `device`; on the CPU that on the wall."""
    return CudaClock(device) if device.is_cuda else HostClock()


def cost_clock_of(device: wp.Device) -> Clock:
    """A clock of what work costs. On the CPU it runs while the calling thread does: waiting for other threads,
    or for Python's lock after a launch, is no cost. Where the system counts that too coarsely, time on the wall stands
    for it."""
    if device.is_cuda:
        return CudaClock(device)
    return HostClock(time.thread_time if time.get_clock_info("thread_time").resolution < 1e-6 else time.perf_counter)


@dataclass(frozen=True)
class _Interval(Generic[Tag]):
    tag: Tag
    start: Any
    end: Any


class Stopwatch(Generic[Tag]):
    """Times intervals of a device's work. They follow one another: none begins before the last has ended."""

    def __init__(self, clock: Clock):
        self._clock = clock
        self._pending: deque[_Interval[Tag]] = deque()
        self._begun: tuple[Tag, Any] | None = None

    def start(self, tag: Tag) -> None:
        """An interval begins; `tag` comes back with its time."""
        assert self._begun is None, f"{tag} begins before {self._begun} has ended"
        self._begun = tag, self._clock.mark()

    def stop(self) -> None:
        """The interval ends."""
        assert self._begun is not None, "an interval ends that has not begun"
        tag, start = self._begun
        self._begun = None
        self._pending.append(_Interval(tag, start, self._clock.mark()))

    def take(self, wait: bool = False) -> list[tuple[Tag, float]]:
        """Tags and times [s] of intervals that are over, the oldest first; `wait` for all of them."""
        taken = []
        while self._pending and (wait or len(self._pending) > PENDING_MAX or self._clock.is_past(self._pending[0].end)):
            interval = self._pending.popleft()
            taken.append((interval.tag, self._clock.seconds(interval.start, interval.end)))
            self._clock.release(interval.start)
            self._clock.release(interval.end)
        return taken


class StageTimer:
    """Sums up the time of each of `STAGES`. `with timer.stage("trace"): ...`; stages are not nested."""

    def __init__(self, clock: Clock):
        self._watch: Stopwatch[str] = Stopwatch(clock)
        self._seconds = dict.fromkeys(STAGES, 0.0)
        self._begun = 0

    def stage(self, name: str) -> StageTimer:
        """What is launched in this context belongs to the stage `name`."""
        assert name in self._seconds, f"{name} is none of {STAGES}"
        self._watch.start(name)
        return self

    def __enter__(self) -> StageTimer:
        return self

    def __exit__(self, *_) -> None:
        self._watch.stop()
        self._begun += 1
        if self._begun % _READ_EVERY == 0:
            self._read(wait=False)

    def totals(self) -> dict[str, float]:
        """Time of every stage so far [s]; waits for the device."""
        self._read(wait=True)
        return dict(self._seconds)

    def _read(self, wait: bool) -> None:
        for name, seconds in self._watch.take(wait):
            self._seconds[name] += seconds


class NoTimer:
    """Stands for a `StageTimer` where nothing is timed."""

    _nothing = contextlib.nullcontext()

    def stage(self, name: str) -> contextlib.AbstractContextManager:
        """Does nothing."""
        return self._nothing

    def totals(self) -> dict[str, float]:
        """No stage."""
        return {}
