"""Storage of rays in queues: numbers of their slots (INDIRECT), or by value all that a traversal needs (DIRECT).

By value, a ray's state lies in the queues' blocks and is copied with it. A batch is traced in memory of its own, in
which rays lie side by side: those that ask for the closest hit at positions below the capacity, the others behind.
`t_max` and `hit_t` share an array there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

import warp as wp

from ....bvh.traverse.counts import TraceCounts, counts_of
from ....bvh.tree import DONE, NEW, TopProgress
from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....rays import NO_ANY_HIT, DeviceRayList, RayList, Rays
from ...rays import RayNeeds, allocate_progress, allocate_rays
from .blocks import QueueRule
from .queues import BucketQueues, batch_capacity


@wp.func
def position_of(batch: DeviceRayList, i: int) -> int:
    """Where ray `i` of the batch lies in the batch's memory."""
    return wp.where(batch.slots[i] >= batch.any_first, batch.capacity + i, i)


@wp.func
def copy_ray(source: Rays, i: int, target: Rays, k: int):
    """Copy what does not change while a ray is traced, and its limit."""
    target.origin[k] = source.origin[i]
    target.direction[k] = source.direction[i]
    target.t_max[k] = source.t_max[i]
    if target.visibility.shape[0] > 0:
        target.visibility[k] = source.visibility[i]
    if target.time.shape[0] > 0:
        count = source.time.shape[0]  # of paths, where these are no copies: a shadow ray has its path's
        target.time[k] = source.time[wp.where(i < count, i, i - count)]


@wp.func
def copy_progress(rays: Rays, progress: TopProgress, i: int, target: Rays, target_progress: TopProgress, k: int):
    """Copy what changes while a ray is traced."""
    target.hit_instance[k] = rays.hit_instance[i]
    target.hit_primitive[k] = rays.hit_primitive[i]
    target.hit_uv[k] = rays.hit_uv[i]
    for word in range(progress.trail.shape[0]):
        target_progress.trail[word, k] = progress.trail[word, i]
    if progress.entry.shape[0] > 0:
        target_progress.entry[k] = progress.entry[i]


@wp.kernel(**KERNEL_OPTIONS)
def store_new_kernel(home: Rays, values: Rays, batch: DeviceRayList):
    """By ray of the batch: copy new rays from their slots to the pool."""
    i = wp.tid()
    if i < batch.count[0]:
        copy_ray(home, batch.slots[i], values, batch.pool_index[i])


@wp.kernel(**KERNEL_OPTIONS)
def load_kernel(
    values: Rays,
    stored: TopProgress,
    work: Rays,
    progress: TopProgress,
    batch: DeviceRayList,
    positions: wp.array(dtype=int),
):
    """By ray of the batch: copy it from the pool to the batch's memory; `positions` receives where it lies there."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    index = batch.pool_index[i]
    position = position_of(batch, i)
    positions[i] = position
    copy_ray(values, index, work, position)
    if batch.locations[i] != NEW:
        copy_progress(values, stored, index, work, progress, position)


@wp.kernel(**KERNEL_OPTIONS)
def store_kernel(
    work: Rays, progress: TopProgress, values: Rays, stored: TopProgress, home: Rays, batch: DeviceRayList
):
    """By ray of the batch: copy it back to the pool, or if it is done its hit to its slot."""
    i = wp.tid()
    if i >= batch.count[0]:
        return
    position = position_of(batch, i)
    if batch.locations[i] != DONE:
        copy_ray(work, position, values, batch.pool_index[i])
        copy_progress(work, progress, position, values, stored, batch.pool_index[i])
        return
    slot = batch.slots[i]
    home.hit_instance[slot] = work.hit_instance[position]
    if slot < batch.any_first:
        home.hit_t[slot] = work.hit_t[position]
        home.hit_primitive[slot] = work.hit_primitive[position]
        home.hit_uv[slot] = work.hit_uv[position]


@wp.kernel(**KERNEL_OPTIONS)
def reset_counts_kernel(counts: TraceCounts, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """By ray of the batch."""
    i = wp.tid()
    if i < count[0]:
        slot = slots[i]
        counts.node_steps[slot] = 0
        counts.box_tests[slot] = 0
        counts.triangle_tests[slot] = 0
        counts.treelet_visits[slot] = 0
        counts.queued[slot] = 0


@wp.kernel(**KERNEL_OPTIONS)
def add_counts_kernel(counts: TraceCounts, batch: DeviceRayList, total: TraceCounts):
    """By ray of the batch: what was counted at its position is added to its slot."""
    i = wp.tid()
    if i < batch.count[0]:
        position, slot = position_of(batch, i), batch.slots[i]
        total.node_steps[slot] = total.node_steps[slot] + counts.node_steps[position]
        total.box_tests[slot] = total.box_tests[slot] + counts.box_tests[position]
        total.triangle_tests[slot] = total.triangle_tests[slot] + counts.triangle_tests[position]
        total.treelet_visits[slot] = total.treelet_visits[slot] + counts.treelet_visits[position]
        total.queued[slot] = total.queued[slot] + counts.queued[position]


# Rays of a batch at most on CUDA: a batch's memory is twice as large as its rays
CUDA_BATCH_BY_VALUE = 1 << 20


class Storage(Protocol):
    """Holds the rays of queues, and says where batches are traced. A batch that was taken is put back before the next
    one is taken.
    """

    kernels: ClassVar[tuple[wp.Kernel, ...]]
    # what stages read and write while they trace a batch that was taken
    rays: Rays
    progress: TopProgress
    any_first: int  # slots of `rays` from here on ask for any hit
    counts: TraceCounts | None

    @staticmethod
    def batch_capacity(slot_count: int, queue_size: int, is_cuda: bool) -> int:
        """Rays of a batch at most."""

    @staticmethod
    def bytes_per_slot(progress_bytes: int, instancing: bool, moving: bool, entry_share: float) -> float:
        """Device memory for each ray slot [bytes]. `progress_bytes`: of a ray's progress; `moving`: rays have times;
        `entry_share`: entries of the pool for each slot.
        """

    def begin(self, batch: RayList, rule: QueueRule) -> None:
        """New rays wait in the queues that `rule` says."""

    def take(self, chosen: Sequence[int] | None, rule: QueueRule, bound: int) -> RayList:
        """See `BucketQueues.take`; the batch's slots are those of `rays`."""

    def take_marked(self, rule: QueueRule, bound: int) -> RayList:
        """See `BucketQueues.take_marked`; the batch's slots are those of `rays`."""

    def put(self, rule: QueueRule) -> None:
        """The rays that were taken last wait where the batch says."""

    def finished(self, batch: RayList) -> RayList:
        """`batch`, rays that are done and out of queues, as slots of those that the storage was made for."""

    def under_way(self, waiting: int) -> int:
        """Rays that are not out of queues yet, where queues hold `waiting`."""

    def clear(self) -> None:
        """No ray is under way any more."""


class _InOnePlace:
    """A ray is in one queue or in none, under the number of its slot."""

    def finished(self, batch: RayList) -> RayList:
        """See `Storage.finished`."""
        return batch

    def under_way(self, waiting: int) -> int:
        """See `Storage.under_way`."""
        return waiting

    def clear(self) -> None:
        """See `Storage.clear`."""


class InPlace(_InOnePlace):
    """Queues hold numbers of ray slots alone (INDIRECT): rays are traced where they are."""

    kernels: ClassVar[tuple[wp.Kernel, ...]] = ()

    def __init__(
        self,
        queues: BucketQueues,
        rays: Rays,
        any_first: int,
        words: int,
        instancing: bool,
        moving: bool,
        counts: TraceCounts | None,
    ):
        """For `rays`, with trails of `words` words; those from slot `any_first` on ask for any hit."""
        self.rays, self.any_first, self.counts = rays, any_first, counts
        self.progress = allocate_progress(queues.slot_count, words, instancing, queues.device)
        self._queues, self._taken = queues, None

    @staticmethod
    def batch_capacity(slot_count: int, queue_size: int, is_cuda: bool) -> int:
        """Rays of a batch at most."""
        return batch_capacity(slot_count, queue_size, is_cuda)

    @staticmethod
    def bytes_per_slot(progress_bytes: int, instancing: bool, moving: bool, entry_share: float) -> float:
        """Progress alone."""
        return progress_bytes

    def begin(self, batch: RayList, rule: QueueRule) -> None:
        """Put the slots into queues."""
        self._queues.put(batch, rule)

    def take(self, chosen: Sequence[int] | None, rule: QueueRule, bound: int) -> RayList:
        """Take slots out of queues."""
        self._taken = self._queues.take(chosen, rule, bound)
        return self._taken

    def take_marked(self, rule: QueueRule, bound: int) -> RayList:
        """Take slots out of the marked queue."""
        self._taken = self._queues.take_marked(rule, bound)
        return self._taken

    def put(self, rule: QueueRule) -> None:
        """Put the slots that were taken last into queues."""
        self._queues.put(self._taken, rule)


class ByValue(_InOnePlace):
    """Queues hold what a traversal needs of rays (DIRECT): they are copied to a batch's memory, and back."""

    kernels: ClassVar[tuple[wp.Kernel, ...]] = (
        store_new_kernel,
        load_kernel,
        store_kernel,
        reset_counts_kernel,
        add_counts_kernel,
    )

    def __init__(
        self,
        queues: BucketQueues,
        home: Rays,
        any_first: int,
        words: int,
        instancing: bool,
        moving: bool,
        counts: TraceCounts | None,
    ):
        """For rays of `home`, with trails of `words` words; those from slot `any_first` on ask for any hit. `moving`:
        their times are looked at.
        """
        device, capacity, entry_count = queues.device, queues.capacity, queues.size.entry_count
        mixed = any_first < home.origin.size
        self._queues, self._home, self._home_counts, self._taken = queues, home, counts, None
        self._launches = RepeatedLaunches(device)
        needs = RayNeeds(limits=False, visibility=home.visibility.size > 0, time=moving)
        self._values = allocate_rays(entry_count, device, needs)
        self._stored = allocate_progress(entry_count, words, instancing, device)
        size = capacity * (2 if mixed else 1)
        self.rays = allocate_rays(size, device, needs)
        self.progress = allocate_progress(size, words, instancing, device)
        self.any_first = capacity if mixed else NO_ANY_HIT
        self._positions = wp.zeros(capacity, dtype=int, device=device)  # of a batch's rays in `rays`
        self._pool_index = wp.zeros(capacity, dtype=int, device=device)
        self._batch = DeviceRayList()
        self._batch.any_first, self._batch.capacity, self._batch.pool_index = any_first, capacity, self._pool_index
        self.counts = None
        if counts is not None:
            self.counts = counts_of(size, device, waits=True)
            self.counts.lanes = counts.lanes

    @staticmethod
    def batch_capacity(slot_count: int, queue_size: int, is_cuda: bool) -> int:
        """Rays of a batch at most."""
        return min(batch_capacity(slot_count, queue_size, is_cuda), max(CUDA_BATCH_BY_VALUE, queue_size))

    @staticmethod
    def bytes_per_slot(progress_bytes: int, instancing: bool, moving: bool, entry_share: float) -> float:
        """Progress and values in every entry of the pool."""
        values = RayNeeds(limits=False, visibility=instancing, time=moving)
        return (progress_bytes + values.bytes_per_path) * entry_share

    def begin(self, batch: RayList, rule: QueueRule) -> None:
        """Put the rays into queues, and their values into the pool."""
        for first in range(0, batch.bound, self._queues.capacity):
            part = self._queues.part(batch, first)
            self._queues.put(part, rule, self._pool_index)
            self._fill(part)
            self._launch(store_new_kernel, part.bound, self._home, self._values, self._batch)
            if self._home_counts is not None:
                self._launch(reset_counts_kernel, part.bound, self._home_counts, part.slots, part.count)

    def take(self, chosen: Sequence[int] | None, rule: QueueRule, bound: int) -> RayList:
        """Take rays out of queues, and copy their values to the batch's memory."""
        return self._load(self._queues.take(chosen, rule, bound, self._pool_index))

    def take_marked(self, rule: QueueRule, bound: int) -> RayList:
        """Take rays as `take` does, of the marked queue."""
        return self._load(self._queues.take_marked(rule, bound, self._pool_index))

    def _load(self, batch: RayList) -> RayList:
        self._taken = batch
        self._fill(batch)
        values, positions = (self._values, self._stored), self._positions
        self._launch(load_kernel, batch.bound, *values, self.rays, self.progress, self._batch, positions)
        if self.counts is not None:
            self._launch(reset_counts_kernel, batch.bound, self.counts, positions, batch.count)
        return RayList(positions, batch.count, batch.bound, batch.locations)

    def put(self, rule: QueueRule) -> None:
        """Put the rays that were taken last into queues, and their values into the pool; hits of those that
        are done go to their slots.
        """
        batch = self._taken
        self._queues.put(batch, rule, self._pool_index)
        self._launch(
            store_kernel, batch.bound, self.rays, self.progress, self._values, self._stored, self._home, self._batch
        )
        if self.counts is not None:
            self._launch(add_counts_kernel, batch.bound, self.counts, self._batch, self._home_counts)

    def _fill(self, batch: RayList) -> None:
        self._batch.slots, self._batch.locations, self._batch.count = batch.slots, batch.locations, batch.count

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        self._launches.launch(kernel, count, *inputs)


STORAGES: dict[str, type[Storage]] = {"INDIRECT": InPlace, "DIRECT": ByValue}  # by the setting `ray_storage`
