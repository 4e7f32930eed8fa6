"""Steps that serve several buckets."""

from __future__ import annotations

import numpy as np
import warp as wp

from .....device.kernel import KERNEL_OPTIONS
from .....measure.timing import NoTimer, StageTimer
from .....native.structs import to_numpy
from ..blocks import OVERFLOW, STEP
from ..policy import QueueNumbers, Step
from ..policy_device import AMOUNT, BUDGET, CHOICE_SIZE, QUEUE, STEP_KIND
from ..queues import BucketQueues
from ..serve import QueueServer
from .interface import Assignment
from .prefetch import TreeletPrefetch


@wp.kernel(**KERNEL_OPTIONS)
def next_step_kernel(state: wp.array(dtype=int)):
    """One thread: a step is over."""
    state[STEP] = state[STEP] + 1


class AssignedSteps:
    """The host asks a policy which buckets are served, and of each serves the queue with more rays; a `Steps`."""

    def __init__(
        self,
        policy: Assignment,
        queues: BucketQueues,
        server: QueueServer,
        timer: StageTimer | NoTimer,
        *,
        numbers: QueueNumbers,
        wait_max: int,
        rays_few: int,
        prefetch: TreeletPrefetch | None = None,
    ):
        """`wait_max` and `rays_few` are those of `BucketPolicy`; `prefetch` is told what is served."""
        self._policy, self._queues, self._server, self._timer = policy, queues, server, timer
        self._numbers, self._wait_max, self._rays_few, self._prefetch = numbers, wait_max, rays_few, prefetch
        self._target = 1
        self._served: list[tuple[Step, list[int], int]] = []

    def begin(self, target: int) -> None:
        """See `Steps.begin`."""
        self._target = target

    def choose(self) -> list[int]:
        """See `Steps.choose`."""
        with self._timer.stage("queue"):
            counts = self._queues.fetch_counts().astype(np.int64)
        done, counts[self._numbers.done] = int(counts[self._numbers.done]), 0
        choice = [0] * CHOICE_SIZE
        choice[QUEUE] = choice[BUDGET] = -1
        choice[AMOUNT] = waiting = int(counts.sum())
        if not waiting or done >= self._target:
            choice[STEP_KIND] = Step.NOTHING
            return choice
        wp.launch(next_step_kernel, 1, [self._queues.blocks.state], device=self._queues.device)
        loads = counts[0::2] + counts[1::2]
        if loads.max() < self._rays_few:
            choice[STEP_KIND] = Step.UNBATCHED
            return choice
        choice[STEP_KIND] = Step.SOME
        chosen = np.union1d(self._fuller_queues(counts, self._policy.choose(loads)), self._urgent_queues(counts, loads))
        if self._prefetch:
            self._prefetch.ask(counts[0::2], np.unique(chosen // 2))
        entries, exits = chosen[chosen % 2 == 0], chosen[chosen % 2 == 1]
        # rays that leave a treelet come to its exit queue, which may be served behind: as many as a batch may have
        amounts = int(counts[entries].sum()), 0 if len(entries) else int(counts[exits].sum())
        served = zip((Step.TREELET, Step.TOP), (entries, exits), amounts)
        self._served = [(step, queues.tolist(), amount) for step, queues, amount in served if len(queues)]
        return choice

    def serve(self, step: Step, choice: list[int]) -> None:
        """Serve what was chosen: entry queues, then exit queues."""
        for kind, queues, amount in self._served:
            self._server.serve(kind, queues, amount)

    def release(self) -> None:
        """Nothing is captured."""

    def _fuller_queues(self, counts: np.ndarray, buckets: np.ndarray) -> np.ndarray:
        """Of each bucket its entry queue, or its exit queue where that has more rays."""
        return 2 * buckets + (counts[2 * buckets] < counts[2 * buckets + 1])

    def _urgent_queues(self, counts: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Queues whose rays waited for as long as they may, and where blocks ran out that of the fullest bucket."""
        urgent, state = np.zeros(0, np.int64), self._queues.fetch_state()
        if self._wait_max:
            waited = int(state[STEP]) - to_numpy(self._queues.blocks.since)
            urgent = np.flatnonzero((counts > 0) & (waited > self._wait_max))
        if state[OVERFLOW] > 0:
            urgent = np.union1d(urgent, self._fuller_queues(counts, loads.argmax(keepdims=True)))
        return urgent
