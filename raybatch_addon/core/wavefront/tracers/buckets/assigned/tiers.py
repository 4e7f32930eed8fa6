"""Serving queues of treelets that are in large ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .....bvh.traverse.task import VisitTask
from .....bvh.treelets.tree import TreeletTree
from ..policy import Step
from ..serve import QueueServer


def bucket_large(tree: TreeletTree) -> np.ndarray:
    """The large treelet that the bucket of each treelet, of each large one and of the root belongs to, int64; -1: to
    none.
    """
    return np.concatenate([tree.treelet_large, np.arange(tree.large_count), [-1]])


class TierServer(QueueServer):
    """Rays that come to a large treelet wait there, and then go through what is in it above its treelets: by the same
    visit as through what is above all of them. Large treelets have the last buckets, of which only entry queues are
    used: behind its last treelet a ray has left the large one too.
    """

    def __init__(self, tree: TreeletTree, *arguments):
        """As `QueueServer`."""
        super().__init__(tree, *arguments)
        count = 2 * tree.treelet_count
        self._small, self._large = range(0, count, 2), range(count, self._numbers.done, 2)

    def serve(self, step: Step, queues: Sequence[int], amount: int) -> None:
        """See `QueueServer.serve`."""
        if step == Step.TREELET:
            large = [queue for queue in queues if queue >= self._large.start]
            queues = [queue for queue in queues if queue < self._large.start]
            if queues:
                super().serve(step, queues, amount)
            if not large:
                return
            step, queues = Step.TOP, large
        super().serve(step, queues, amount)

    def sweep(self, amount: int) -> None:
        """See `QueueServer.sweep`; rays that come from one large treelet to another wait for the next."""
        self._serve_all(self._numbers.exits_and_new, VisitTask.TOP)
        self._serve_all(self._large, VisitTask.TOP)
        self._serve_all(self._small, VisitTask.TREELET)

    def finish_all(self) -> int:
        """See `QueueServer.finish_all`: all buckets are swept until no ray waits."""
        count = self._left()
        while self._left():
            self.sweep(0)
        return count

    def _left(self) -> int:
        return self._queues.waiting - int(self._queues.fetch_counts()[self._numbers.done])
