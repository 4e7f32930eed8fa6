"""Steps of the scheduler on the CPU with as few launches as can be: a step's queue is chosen and taken by one, and put back by another.

Both are recorded once, which saves most of what a launch costs.
"""

from __future__ import annotations

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .bucket_blocks import Blocks, Listed, QueueRule
from .bucket_blocks_host import host_put_kernel, take_queue
from .bucket_policy import Step
from .bucket_policy_kernel import QUEUE, DevicePolicy, PolicyState, decide, look_at_buckets
from .bucket_queues import BucketQueues
from .stages.visit import Batch

_QUEUE = wp.constant(QUEUE)


@wp.kernel(**KERNEL_OPTIONS)
def host_step_kernel(blocks: Blocks, rule: QueueRule, rays: Listed, policy: PolicyState):
    """One thread: choose a queue and take its rays."""
    look_at_buckets(blocks, policy, 0, 1)
    decide(blocks, policy)
    queue = policy.choice[_QUEUE]
    if queue >= 0:
        rays.count[0] = take_queue(blocks, rule, rays, queue, 0)


class HostSteps:
    """Chooses, takes and puts; for `INDIRECT` queues of one thread."""

    def __init__(self, queues: BucketQueues, policy: DevicePolicy, entry: QueueRule, exit_: QueueRule):
        """`entry` and `exit_` say where rays wait behind each kind of step."""
        rays, blocks, device = queues.taken, queues.blocks, queues.device
        rays.places = queues.nowhere
        self._policy, self._count, self._rays = policy, rays.count.numpy(), rays
        self._take = wp.launch(host_step_kernel, 1, [blocks, entry, rays, policy.state], device=device, record_cmd=True)
        self._put = {
            step: wp.launch(host_put_kernel, 1, [blocks, rule, rays], device=device, record_cmd=True)
            for step, rule in ((Step.TOP, entry), (Step.TREELET, exit_))
        }

    def next(self) -> list[int]:
        """`PolicyState.choice`; the rays of the chosen queue are taken."""
        self._take.launch()
        return self._policy.fetch()

    def batch(self) -> Batch:
        """They."""
        return Batch(self._rays.slots, self._rays.where, self._rays.count, int(self._count[0]))

    def put(self, step: Step) -> None:
        """They wait again."""
        self._put[step].launch()
