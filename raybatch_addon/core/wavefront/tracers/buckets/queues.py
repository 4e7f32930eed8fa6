"""Queues of rays that wait: put in and taken out in batches, by counting, sums and scatter, without locks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....native.structs import to_numpy
from ....rays import DeviceRayList, RayList
from .blocks import (
    IN_USE_PEAK,
    OVERFLOW,
    SHORT,
    WAIT_MAX,
    WAITING,
    BlockCheck,
    PoolSize,
    QueueRule,
    allocate_blocks,
    clear_blocks,
    pool_size,
)
from .blocks_device import DeviceQueues
from .blocks_host import host_put_kernel, host_take_kernel

# Rays of a batch at most, so that what a batch needs does not grow with the rays alive
CPU_BATCH, CUDA_BATCH = 1 << 16, 1 << 22


def batch_capacity(slot_count: int, queue_size: int, is_cuda: bool) -> int:
    """Rays of a batch at most."""
    return max(queue_size, min(max(1, slot_count), CUDA_BATCH if is_cuda else CPU_BATCH))


def queue_rule(scale: int = 1, shift: int = 0, done: int = -1, new: int = -1) -> QueueRule:
    """`QueueRule`; as it is, the queue is the treelet."""
    rule = QueueRule()
    rule.scale, rule.shift, rule.done_queue, rule.new_queue = scale, shift, done, new
    return rule


SAME = queue_rule()


class BucketQueues:
    """All queues of a worker. A ray waits in one of them or in none.

    Queues are numbered from 0. The location of a ray in a batch is its queue, or by a `QueueRule` what stands
    for it; rays whose location is `DONE` or `NEW` wait nowhere, unless the rule has queues for them.
    """

    def __init__(
        self,
        queue_total: int,
        queue_size: int,
        queue_count: int,
        slot_count: int,
        device: wp.Device,
        debug: bool = False,
        capacity: int = 0,
        parallel: bool | None = None,
    ):
        """Queues for rays of `slot_count` slots at most, in blocks of `queue_size` rays, `queue_count` of them; 0 for
        what suits.

        Batches that are taken have at most `capacity` rays (0: `batch_capacity`). `debug`: every transaction is
        checked. `parallel`: the way of CUDA devices, which works on the CPU too.
        """
        self.device, self.queue_total, self.slot_count = device, queue_total, slot_count
        self.size: PoolSize = pool_size(queue_total, queue_size, queue_count, slot_count)
        block = self.size.queue_size
        self.capacity = max(capacity, block) if capacity else batch_capacity(slot_count, block, device.is_cuda)
        self._parallel = device.is_cuda if parallel is None else parallel
        self.blocks = allocate_blocks(self.size, queue_total, device, not self._parallel)
        self.parallel_queues = DeviceQueues(self.blocks, self.capacity, device) if self._parallel else None
        self._check = BlockCheck(self.blocks, slot_count) if debug else None
        self.taken = DeviceRayList()
        self.taken.slots, self.taken.locations = (
            wp.zeros(self.capacity, dtype=int, device=device),
            wp.zeros(self.capacity, dtype=int, device=device),
        )
        self.taken.count = wp.zeros(1, dtype=int, device=device)
        self.nowhere = wp.zeros(0, dtype=int, device=device)
        self._part_count = wp.zeros(1, dtype=int, device=device)
        self.taken.pool_index, self.taken.capacity = self.nowhere, self.capacity
        self._given = DeviceRayList()
        self._given.pool_index, self._given.capacity = self.nowhere, 0
        if not self._parallel:
            # what the host looks at after every step, without a copy
            self._state, self._counts, self._count = (
                to_numpy(self.blocks.state),
                to_numpy(self.blocks.counts),
                to_numpy(self.taken.count),
            )
            self._chosen = wp.zeros(queue_total, dtype=int, device=device)
            self._launches = RepeatedLaunches(device)
            self._chosen_view = to_numpy(self._chosen)

    @property
    def counts(self) -> wp.array:
        """Rays that wait in each queue, int32, shape [queue_total], on the device."""
        return self.blocks.counts

    def fetch_counts(self) -> np.ndarray:
        """A copy of `counts` on the host."""
        return self._counts.copy() if not self._parallel else to_numpy(self.blocks.counts).copy()

    def put(self, batch: RayList, rule: QueueRule = SAME, pool_index: wp.array | None = None) -> None:
        """The rays of `batch` wait in queues from now on. `pool_index` receives the entries of the pool in which they
        lie, -1 for those that wait nowhere.
        """
        if batch.bound == 0:
            return
        seen = self._seen(batch) if self._check else None
        rays = self._given
        for first in range(0, batch.bound, self.capacity) if self._parallel else (0,):
            part = self.part(batch, first) if self._parallel else batch
            rays.slots, rays.locations, rays.count = part.slots, part.locations, part.count
            rays.pool_index = self.nowhere if pool_index is None else pool_index[first : first + part.bound]
            if self._parallel:
                self.parallel_queues.put(rule, rays, part.bound)
            else:
                self._launches.launch(host_put_kernel, 1, self.blocks, rule, rays)
        if seen:
            self._check.put(*seen, rule)

    def take(
        self, chosen: Sequence[int] | None, rule: QueueRule = SAME, bound: int = 0, pool_index: wp.array | None = None
    ) -> RayList:
        """Rays of the queues `chosen` (None: all): all of them, or as many as a batch may have. The batch is
        overwritten by the next.

        `bound`: the caller knows that there are no more rays. `pool_index` receives the entries of the pool in which
        the rays lay.
        """
        rays = self.taken
        rays.pool_index = self.nowhere if pool_index is None else pool_index
        bound = min(bound, self.capacity) if bound else self.capacity
        if self._parallel:
            self.parallel_queues.take(rule, rays, bound, self.parallel_queues.choose(chosen))
        else:
            if chosen is None:
                count = -1
            else:
                count = len(chosen)
                self._chosen_view[:count] = chosen
            self._launches.launch(host_take_kernel, 1, self.blocks, rule, rays, self._chosen, count)
            bound = int(self._count[0])
        batch = RayList(rays.slots, rays.count, bound, rays.locations)
        if self._check:
            self._check.take(
                *self._seen(batch), rule, np.arange(self.queue_total) if chosen is None else np.asarray(chosen)
            )
        return batch

    def take_marked(self, rule: QueueRule, bound: int, pool_index: wp.array | None = None) -> RayList:
        """Take rays as `take` does, of one queue that was marked on the device; not checked, and nothing is asked of
        the host.
        """
        self.taken.pool_index = self.nowhere if pool_index is None else pool_index
        self.parallel_queues.take(rule, self.taken, bound, 1)
        return RayList(self.taken.slots, self.taken.count, bound, self.taken.locations)

    def part(self, batch: RayList, first: int) -> RayList:
        """At most `capacity` rays of `batch` from `first` on; the next part overwrites their count."""
        bound = min(batch.bound - first, self.capacity)
        if bound == batch.bound:
            return batch
        end = first + bound
        wp.launch(rest_kernel, 1, [batch.count, first, bound, self._part_count], device=self.device)
        return RayList(batch.slots[first:end], self._part_count, bound, batch.locations[first:end])

    def clear(self) -> None:
        """The rays that wait are forgotten."""
        clear_blocks(self.blocks)
        if self._check:
            self._check.clear()

    def fetch_state(self) -> np.ndarray:
        """`Blocks.state` on the host."""
        return self._state if not self._parallel else to_numpy(self.blocks.state)

    def totals(self) -> dict[str, int]:
        """For `BatchingTotals`."""
        state = self.fetch_state()
        names = {"blocks_peak": IN_USE_PEAK, "blocks_short": SHORT, "wait_max": WAIT_MAX}
        counts = {name: int(state[place]) for name, place in names.items()}
        return counts | {"rays_queued": int(to_numpy(self.blocks.put)[0]), "block_count": self.size.block_count}

    @property
    def waiting(self) -> int:
        """Rays that wait in all queues."""
        return int(self.fetch_state()[WAITING])

    @property
    def overflowing(self) -> int:
        """Rays that found no place in a block."""
        return int(self.fetch_state()[OVERFLOW])

    def _seen(self, batch: RayList) -> tuple[np.ndarray, np.ndarray]:
        """Copies of slots and locations of a batch."""
        count = int(to_numpy(batch.count)[0])
        assert count <= batch.bound, f"a batch of {count} rays says that there are {batch.bound} at most"
        return to_numpy(batch.slots)[:count].copy(), to_numpy(batch.locations)[:count].copy()


@wp.kernel(**KERNEL_OPTIONS)
def rest_kernel(count: wp.array(dtype=int), first: int, bound: int, rest: wp.array(dtype=int)):
    """One thread: how many rays of a batch there are from `first` on, `bound` at most."""
    rest[0] = wp.clamp(count[0] - first, 0, bound)


def queue_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """The kernels that `BucketQueues` launch on `device`."""
    return (*DeviceQueues.kernels, rest_kernel) if device.is_cuda else (host_put_kernel, host_take_kernel, rest_kernel)
