"""Who leads from step to step of the scheduler: the host with launches for any device (`LaunchedSteps`), the host with
as few launches as can be (`FusedSteps`, CPU), or the device itself (`LoopSteps`, CUDA).
"""

from __future__ import annotations

from typing import Protocol

import warp as wp

from ....bvh.traverse.task import VisitTask
from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....measure.timing import NoTimer, StageTimer
from ....native.structs import to_numpy
from ....rays import DeviceRayList, RayList
from .blocks import Blocks, QueueRule
from .blocks_host import host_put_kernel, take_queue
from .device_loop import LOOP_STEPS, DeviceLoop
from .policy import Step
from .policy_device import AMOUNT, GO, QUEUE, DevicePolicy, PolicyState, decide, look_at_buckets
from .queues import BucketQueues
from .serve import QueueRules, QueueServer


class Steps(Protocol):
    """Chooses steps, and serves the queue that was chosen."""

    def begin(self, target: int) -> None:
        """Steps from now on until `target` rays are done, or the host should look at how many wait."""

    def choose(self) -> list[int]:
        """`PolicyState.choice` of the next step that the host is to do."""

    def serve(self, step: Step, choice: list[int]) -> None:
        """Do the chosen step, which is TOP, TREELET or SOME."""

    def release(self) -> None:
        """Give up what was captured; no step is under way, and none comes."""


class LaunchedSteps:
    """The host chooses, takes, traces and puts, each by launches of its own."""

    def __init__(self, policy: DevicePolicy, server: QueueServer, timer: StageTimer | NoTimer):
        self._policy, self._server, self._timer = policy, server, timer

    def begin(self, target: int) -> None:
        """Let the host lead."""
        self._policy.begin(target)

    def choose(self) -> list[int]:
        """Launch the choice and wait for it."""
        with self._timer.stage("queue"):
            self._policy.launch()
            return self._policy.fetch()

    def serve(self, step: Step, choice: list[int]) -> None:
        """Serve the chosen queue."""
        self._server.serve(step, [choice[QUEUE]], choice[AMOUNT])

    def release(self) -> None:
        """Nothing is captured."""


class LoopSteps(LaunchedSteps):
    """The device takes steps by itself, in a captured loop, and the host those that a loop cannot. Where the device
    cannot loop, the host leads.
    """

    def __init__(self, policy: DevicePolicy, server: QueueServer, timer: StageTimer | NoTimer, loop: DeviceLoop):
        super().__init__(policy, server, timer)
        self._loop = loop if loop.prepare() else None

    def begin(self, target: int) -> None:
        """Let the device lead for `LOOP_STEPS` steps."""
        self._policy.begin(target, LOOP_STEPS if self._loop else -1)

    def choose(self) -> list[int]:
        """Choose, and let the device go on by itself as far as it may; its steps are timed as one."""
        choice = super().choose()
        if not choice[GO]:
            return choice
        with self._timer.stage("treelet"):
            self._loop.run()
        return self._policy.fetch()

    def release(self) -> None:
        """See `Steps.release`."""
        if self._loop:
            self._loop.release()


@wp.kernel(**KERNEL_OPTIONS)
def host_step_kernel(blocks: Blocks, rule: QueueRule, rays: DeviceRayList, policy: PolicyState):
    """One thread: choose a queue and take its rays."""
    look_at_buckets(blocks, policy, 0, 1)
    decide(blocks, policy)
    queue = policy.choice[QUEUE]
    if queue >= 0:
        rays.count[0] = take_queue(blocks, rule, rays, queue, 0)


class FusedSteps:
    """One launch chooses a queue and takes its rays, and another puts them back; for INDIRECT queues of one CPU
    thread.
    """

    def __init__(
        self,
        policy: DevicePolicy,
        server: QueueServer,
        timer: StageTimer | NoTimer,
        queues: BucketQueues,
        rules: QueueRules,
    ):
        rays = queues.taken
        rays.pool_index = queues.nowhere
        self._policy, self._server, self._timer = policy, server, timer
        self._rays, self._count = rays, to_numpy(rays.count)
        self._take = RepeatedLaunches(queues.device)
        self._take_inputs = (queues.blocks, rules.entry, rays, policy.state)
        # one each, so that the rule of a kept launch stays
        self._put = {step: RepeatedLaunches(queues.device) for step in (Step.TOP, Step.TREELET)}
        self._put_inputs = {Step.TOP: (queues.blocks, rules.top, rays), Step.TREELET: (queues.blocks, rules.exit, rays)}

    def begin(self, target: int) -> None:
        """Let the host lead."""
        self._policy.begin(target)

    def choose(self) -> list[int]:
        """Choose a queue and take its rays."""
        with self._timer.stage("queue"):
            self._take.launch(host_step_kernel, 1, *self._take_inputs)
            return self._policy.fetch()

    def serve(self, step: Step, choice: list[int]) -> None:
        """Trace the rays that were taken, and put them back."""
        rays = self._rays
        batch = RayList(rays.slots, rays.count, int(self._count[0]), rays.locations)
        self._server.trace(batch, VisitTask.TOP if step == Step.TOP else VisitTask.TREELET)
        with self._timer.stage("queue"):
            self._put[step].launch(host_put_kernel, 1, *self._put_inputs[step])

    def release(self) -> None:
        """Nothing is captured."""
