"""Work on a thread of its own, which a cancelled render leaves behind."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from ..device.compiler import given_up_when
from ..device.loading import loads_noted
from ..measure.parts import Parts

T = TypeVar("T")

POLL_SECONDS = 0.02


def run_aside(work: Callable[[], T], cancelled: Callable[[], bool], on_wait: Callable[[], None]) -> Future[T]:
    """Run `work`, and return when it is done or the render is cancelled; then it goes on by itself.

    On this thread `cancelled` is asked and `on_wait` called, several times a second.
    """
    pool = ThreadPoolExecutor(max_workers=1)
    try:
        future = pool.submit(work)
        while not future.done() and not cancelled():
            on_wait()
            wait([future], POLL_SECONDS)
        return future
    finally:
        pool.shutdown(wait=False)


def once_free(before: Future | None, work: Callable[[], T], closed: Callable[[], bool], parts: Parts) -> T:
    """What `work` returns, begun when `before` is done: what a cancelled render left behind may use the same caches.

    Compilers stop once the session is `closed`, and time that is waited for kernels goes by its own name in `parts`.
    """
    if before and not before.done():
        parts.enter("wait")
        wait([before])
    with given_up_when(closed), kernels_apart(parts):
        return work()


@contextlib.contextmanager
def kernels_apart(parts: Parts) -> Iterator[None]:
    """Inside, the time that this thread waits for kernels that it launches is not that of the part that goes on."""
    before = parts.part

    def note(begins: bool) -> None:
        nonlocal before
        if begins:
            before = parts.part
        parts.enter("kernels" if begins else before)

    with loads_noted(note):
        yield
