"""Work on a thread of its own, which a cancelled render leaves behind."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from ..device.compiler import given_up_when
from ..device.loading import loads_noted
from ..measure.parts import Parts

T = TypeVar("T")

_POLL_SECONDS = 0.02


class WaitedParts:
    """The clock of a render, as work aside turns it: as long as the render waits for that work."""

    def __init__(self, parts: Parts):
        """The render waits from now on."""
        self._parts, self._lock = parts, threading.Lock()
        self._given_up = False

    @property
    def part(self) -> str:
        """The part of the render that goes on."""
        return self._parts.part

    def enter(self, part: str) -> None:
        """The next part begins, unless nobody waits for it."""
        with self._lock:
            if not self._given_up:
                self._parts.enter(part)

    def give_up(self) -> None:
        """The render waits no more: `enter` does nothing from now on."""
        with self._lock:
            self._given_up = True

    def is_given_up(self) -> bool:
        """Whether nobody waits for the work."""
        return self._given_up


def begin_aside(work: Callable[[], T]) -> Future[T]:
    """What `work` will return, which begins on a thread of its own."""
    pool = ThreadPoolExecutor(max_workers=1)
    try:
        return pool.submit(work)
    finally:
        pool.shutdown(wait=False)


def is_awaited(future: Future, cancelled: Callable[[], bool], on_wait: Callable[[], None]) -> bool:
    """Wait until `future` is done, which is True, or the render is `cancelled`; then the work goes on by itself.

    On this thread `cancelled` is asked and `on_wait` called, several times a second.
    """
    while not future.done() and not cancelled():
        on_wait()
        wait([future], _POLL_SECONDS)
    return future.done()


def end_of(future: Future) -> Future[None]:
    """Is done once `future` is, and does not keep what that made."""
    over: Future[None] = Future()
    future.add_done_callback(lambda _: over.set_result(None))
    return over


def once_free(before: Future | None, work: Callable[[], T], closed: Callable[[], bool], parts: WaitedParts) -> T:
    """What `work` returns, begun when `before` is done: what a cancelled render left behind may use the same caches.

    Compilers stop once the session is `closed`, and time that is waited for kernels goes by its own name in `parts`.
    """
    if before and not before.done():
        parts.enter("wait")
        wait([before])
    with given_up_when(closed), kernels_apart(parts):
        return work()


@contextlib.contextmanager
def kernels_apart(parts: WaitedParts) -> Iterator[None]:
    """Inside, the time that this thread waits for kernels that it launches is not that of the part that goes on."""
    before = parts.part

    def note(begins: bool) -> None:
        nonlocal before
        if begins:
            before = parts.part
        parts.enter("kernels" if begins else before)

    with loads_noted(note):
        yield
