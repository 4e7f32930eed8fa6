"""Serving queues: rays are taken out of them, traced, and put into the queues of where they came to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ....bvh.traverse.task import VisitTask
from ....bvh.tree import Treelets
from ....bvh.treelets.tree import TreeletTree
from ....measure.timing import NoTimer, StageTimer
from ....rays import RayList
from ..visit import VisitStage
from .blocks import QueueRule
from .policy import QueueNumbers, Step
from .queues import BucketQueues, queue_rule
from .storage import Storage


class QueueRules:
    """How locations stand for queues: `entry` for rays that come to a treelet, `exit` for those that leave one, `top`
    for those that went through the top level, `begin` for new rays.
    """

    def __init__(self, numbers: QueueNumbers, writes_queues: bool = False):
        """`writes_queues`: the task TOP says itself which queue it is (`VisitOptions.writes_queues`)."""
        self.entry = queue_rule(2, 0, numbers.done, numbers.new)
        self.exit = queue_rule(2, 1, numbers.done, numbers.new)
        self.top = queue_rule(1, 0, numbers.done, numbers.new) if writes_queues else self.entry
        self.begin = queue_rule(0, numbers.new)  # whatever the batch says


class QueueServer:
    """Serves queues of one tracer."""

    def __init__(
        self,
        treelet_tree: TreeletTree,
        stages: Mapping[VisitTask, VisitStage],
        queues: BucketQueues,
        storage: Storage,
        numbers: QueueNumbers,
        timer: StageTimer | NoTimer,
    ):
        """Rays in `queues` visit `treelet_tree`; what is done is timed by `timer`."""
        self._tree, self._treelets = treelet_tree.tree, treelet_tree.treelets
        self._stages, self._queues, self._storage, self._numbers, self._timer = stages, queues, storage, numbers, timer
        self._rules = QueueRules(numbers, stages[VisitTask.TOP].writes_queues)
        self._after = {
            VisitTask.TOP: self._rules.top,
            VisitTask.TREELET: self._rules.exit,
            VisitTask.GO_ON: self._rules.entry,
        }

    def serve(self, step: Step, queues: Sequence[int], amount: int) -> None:
        """Rays of exit queues go on through the top level, those of entry queues visit their treelets; there are
        `amount` at most.
        """
        self._do(self._task_of(step), self._take(queues, amount))

    def serve_marked(self, step: Step, bound: int) -> None:
        """Serve, as `serve` does, the queue that is marked on the device."""
        with self._timer.stage("queue"):
            batch = self._storage.take_marked(self._rules.entry, bound)
        self._do(self._task_of(step), batch)

    def sweep(self, amount: int) -> None:
        """Serve all entry queues, or where rays have not begun or wait behind their treelet, all exit queues; `amount`
        rays wait.
        """
        self._serve_all(self._numbers.exits_and_new, VisitTask.TOP)
        if amount > self._queues.capacity:
            self._serve_all(self._numbers.entries, VisitTask.TREELET)
            return
        # all rays fit a batch: behind their treelet they go on through the top level at once
        batch = self._take(self._numbers.entries, amount)
        self.trace(batch, VisitTask.TREELET, VisitTask.TOP)
        self._put(self._rules.top)

    def go_on(self, queues: Sequence[int], amount: int, there: Treelets) -> None:
        """Rays of `queues`, `amount` at most, begin or enter their treelets, and go on through all that is `there`,
        until they come to a treelet that is not.
        """
        batch, storage = self._take(queues, amount), self._storage
        with self._timer.stage("treelet"):
            self._stages[VisitTask.GO_ON].launch(
                self._tree, there, storage.rays, storage.progress, batch, storage.any_first, storage.counts
            )
        self._put(self._rules.entry)

    def finish_all(self) -> int:
        """All rays go on, unbatched, until they are done; how many had not left their treelet."""
        self._serve_all(self._numbers.exits, VisitTask.TOP)
        while self._stages[VisitTask.TOP].writes_queues and self._count(self._numbers.exits):  # some were put back
            self._serve_all(self._numbers.exits, VisitTask.TOP)
        count = self._queues.waiting - int(self._queues.fetch_counts()[self._numbers.done])
        self._serve_all(range(self._numbers.new, self._numbers.new + 1), VisitTask.GO_ON)
        self._serve_all(self._numbers.entries, VisitTask.GO_ON)
        return count

    def trace(self, batch: RayList, *tasks: VisitTask) -> None:
        """Do `tasks`, one after another; rays that are done are passed over."""
        storage = self._storage
        for task in tasks:
            with self._timer.stage("top level" if task == VisitTask.TOP else "treelet"):
                self._stages[task].launch(
                    self._tree, self._treelets, storage.rays, storage.progress, batch, storage.any_first, storage.counts
                )

    @staticmethod
    def _task_of(step: Step) -> VisitTask:
        return VisitTask.TOP if step == Step.TOP else VisitTask.TREELET

    def _do(self, task: VisitTask, batch: RayList) -> None:
        """Trace the batch that was taken last, and put it back."""
        self.trace(batch, task)
        self._put(self._after[task])

    def _serve_all(
        self, queues: range, task: VisitTask, do: Callable[[VisitTask, RayList], None] | None = None
    ) -> None:
        """Do `task` for all rays of `queues`, which get none by that but those that SHORT_SEGMENT puts back; `do`:
        instead of `_do`.
        """
        left = self._count(queues)
        while left > 0:
            batch = self._take(queues, left)
            (do or self._do)(task, batch)
            left = self._count(queues) if left > batch.bound else 0

    def _count(self, queues: range) -> int:
        return int(self._queues.fetch_counts()[queues.start : queues.stop : queues.step].sum())

    def _take(self, queues: Sequence[int], amount: int) -> RayList:
        with self._timer.stage("queue"):
            return self._storage.take(queues, self._rules.entry, amount)

    def _put(self, rule: QueueRule) -> None:
        with self._timer.stage("queue"):
            self._storage.put(rule)
