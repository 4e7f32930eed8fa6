"""Serving queues of rays that wait at several treelets at a time (the thesis, 6.4)."""

from __future__ import annotations

from .....bvh.traverse.task import VisitTask
from .....rays import RayList
from ..policy import QueueNumbers
from ..queues import queue_rule
from ..serve import QueueServer
from .storage import RayCopies


class SeveralServer(QueueServer):
    """Behind the top level a ray waits at as many treelets as it has places for, in the order in which it meets them.
    When all were served it goes on behind the last of them.
    """

    _storage: RayCopies

    def __init__(self, *arguments):
        """As `QueueServer`, whose storage is `RayCopies`."""
        super().__init__(*arguments)
        numbers: QueueNumbers = self._numbers
        self._sent = queue_rule(2, 0)  # copies that are done wait nowhere
        self._back = queue_rule(2, 1, numbers.done)  # nor do those that wait for others of their ray

    def sweep(self, amount: int) -> None:
        """See `QueueServer.sweep`."""
        self._serve_all(self._numbers.exits_and_new, VisitTask.TOP)
        self._serve_all(self._numbers.entries, VisitTask.TREELET)

    def finish_all(self) -> int:
        """See `QueueServer.finish_all`: before they go on alone, rays leave the treelets that they wait at."""
        self._serve_all(self._numbers.entries, VisitTask.TREELET)
        self._serve_all(self._numbers.exits, VisitTask.TOP, self._do_alone)
        count = self._queues.waiting - int(self._queues.fetch_counts()[self._numbers.done])
        self._serve_all(range(self._numbers.new, self._numbers.new + 1), VisitTask.GO_ON, self._do_alone)
        self._serve_all(self._numbers.entries, VisitTask.GO_ON, self._do_alone)
        return count

    def _do(self, task: VisitTask, batch: RayList) -> None:
        storage = self._storage
        if task is VisitTask.TREELET:
            storage.enter(batch)
            self.trace(batch, task)
            storage.leave(batch)
            self._put(self._back)
            return
        self.trace(batch, task)
        before, passes = batch, storage.width - 1
        for k in range(passes):
            before = storage.spread(before, k)
            self.trace(before, task)
        storage.send(batch, passes)
        self._put(self._rules.entry)
        with self._timer.stage("queue"):
            storage.put_spread(passes, self._sent)

    def _do_alone(self, task: VisitTask, batch: RayList) -> None:
        """Without other copies."""
        self.trace(batch, task)
        self._storage.send(batch, 0)
        self._put(self._rules.entry)
