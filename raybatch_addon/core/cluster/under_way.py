"""The renders of a session that are under way: one goes on where another leaves workers without a task."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass, field

from ..measure.parts import Parts
from .connection import ClusterError, Connection
from .render import ClusterRender

_POLL_SECONDS = 0.05


@dataclass(eq=False)
class UnderWay:
    """A render that goes on by itself."""

    render: ClusterRender
    parts: Parts
    begun: float = field(default_factory=time.perf_counter)
    error: BaseException | None = None  # that ended it
    is_cancelled: bool = False  # nobody wants it
    ended: threading.Event = field(default_factory=threading.Event)
    is_awaited: bool = False  # it goes first

    @property
    def is_over(self) -> bool:
        """Whether nothing of it is to be done any more."""
        return self.render.is_over or self.is_cancelled or self.error is not None


class RendersUnderWay:
    """Takes all renders of a connection further, on a thread of its own: the one that is waited for first, others in
    the order in which they began. Each gets the workers that those before leave.
    """

    def __init__(self, connection: Connection):
        self._connection = connection
        self._lock = threading.Lock()
        self._all: list[UnderWay] = []
        self._thread: threading.Thread | None = None

    def add(self, each: UnderWay) -> None:
        """It goes on from now on."""
        with self._lock:
            self._all.append(each)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="RayBatch cluster renders", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """None of them is wanted any more."""
        with self._lock:
            thread, left = self._thread, [*self._all]
        for each in left:
            each.is_cancelled = True
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        try:
            while self._goes_on():
                self._connection.wait(_POLL_SECONDS)
        except BaseException as error:  # nobody may wait for what does not come
            with self._lock:
                left, self._all, self._thread = self._all, [], None
            for each in left:
                each.error = each.error or error
                self._end(each)
            raise

    def _goes_on(self) -> bool:
        """One step of all renders; False where there are none."""
        with self._lock:
            over = [each for each in self._all if each.is_over]
        for each in over:  # without the lock: it asks the scheduler
            self._end(each)
        with self._lock:
            self._all = [each for each in self._all if each not in over]
            if not self._all:
                self._thread = None
                return False
            now = sorted(self._all, key=lambda each: not each.is_awaited)
        self._step(now)
        return True

    @staticmethod
    def _end(each: UnderWay) -> None:
        each.parts.enter("wait")  # until it is asked for
        try:
            each.render.close()
        finally:
            each.ended.set()

    def _step(self, renders: list[UnderWay]) -> None:
        for each in renders:
            self._go_on(each, each.render.look)
        for each in renders:  # once it is known who left workers
            others = [other.render for other in renders if other is not each]
            self._go_on(each, lambda each=each, others=others: each.render.issue(sum(o.tasks_running for o in others)))
            if each.render.is_rendering and each.parts.part != "render":
                each.parts.enter("render")
        if self._connection.is_lost:
            self._reconnect(renders)

    def _go_on(self, each: UnderWay, work: Callable[[], None]) -> None:
        """An error ends one render, and is raised where that is waited for."""
        if each.is_over or self._connection.is_lost:
            return
        try:
            work()
        except Exception as error:
            # where the connection is lost it may be for that, and nothing that was asked of it will come
            may_be_for_that = isinstance(error, (ClusterError, CancelledError, OSError, RuntimeError, ValueError))
            if not (may_be_for_that and self._connection.was_lost()):
                each.error = error

    def _reconnect(self, renders: list[UnderWay]) -> None:
        try:
            is_there = self._connection.reconnect(lambda: any(each.is_cancelled for each in renders))
        except ClusterError as error:
            for each in renders:
                each.error = each.error or error
            return
        for each in renders if is_there else []:
            self._go_on(each, each.render.begin_again)
