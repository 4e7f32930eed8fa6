"""Rays in queues by value (DIRECT): what a traversal needs of a ray lies in the queues' blocks, and is copied with it.

A batch is traced in memory of its own, in which rays lie side by side: those that ask for the closest hit in places below the
capacity, the others behind. `t_max` and `hit_t` share an array here.
"""

from __future__ import annotations

import warp as wp

from ..bvh.trace_counts import TraceCounts
from ..bvh.tree import DONE, NEW, TopProgress
from ..kernel import KERNEL_OPTIONS
from ..launches import RepeatedLaunches
from .rays import Rays, allocate_progress
from .stages.visit import NO_ANY_HIT, Batch

_DONE, _NEW = wp.constant(DONE), wp.constant(NEW)


@wp.struct
class Moved:
    """Rays of a batch."""

    slots: wp.array(dtype=int)
    where: wp.array(dtype=int)
    places: wp.array(dtype=int)  # among the queues' places
    positions: wp.array(dtype=int)  # in the batch's memory
    count: wp.array(dtype=int)
    any_first: int  # slots from here on ask for any hit
    capacity: int


@wp.func
def position_of(moved: Moved, i: int) -> int:
    """Where ray `i` of the batch lies."""
    return wp.where(moved.slots[i] >= moved.any_first, moved.capacity + i, i)


@wp.func
def copy_ray(source: Rays, i: int, target: Rays, k: int):
    """What does not change while a ray is traced, and its limit."""
    target.origin[k] = source.origin[i]
    target.direction[k] = source.direction[i]
    target.t_max[k] = source.t_max[i]
    if target.visibility.shape[0] > 0:
        target.visibility[k] = source.visibility[i]


@wp.func
def copy_progress(rays: Rays, progress: TopProgress, i: int, target: Rays, target_progress: TopProgress, k: int):
    """What changes."""
    target.hit_instance[k] = rays.hit_instance[i]
    target.hit_primitive[k] = rays.hit_primitive[i]
    target.hit_uv[k] = rays.hit_uv[i]
    for word in range(progress.trail.shape[0]):
        target_progress.trail[word, k] = progress.trail[word, i]
    if progress.entry.shape[0] > 0:
        target_progress.entry[k] = progress.entry[i]


@wp.kernel(**KERNEL_OPTIONS)
def store_new_kernel(home: Rays, values: Rays, moved: Moved):
    """By ray of the batch: new rays go to the queues' places."""
    i = wp.tid()
    if i < moved.count[0]:
        copy_ray(home, moved.slots[i], values, moved.places[i])


@wp.kernel(**KERNEL_OPTIONS)
def load_kernel(values: Rays, stored: TopProgress, work: Rays, progress: TopProgress, moved: Moved):
    """By ray of the batch: from the queues' places to the batch's memory."""
    i = wp.tid()
    if i >= moved.count[0]:
        return
    place = moved.places[i]
    position = position_of(moved, i)
    moved.positions[i] = position
    copy_ray(values, place, work, position)
    if moved.where[i] != _NEW:
        copy_progress(values, stored, place, work, progress, position)


@wp.kernel(**KERNEL_OPTIONS)
def store_kernel(work: Rays, progress: TopProgress, values: Rays, stored: TopProgress, home: Rays, moved: Moved):
    """By ray of the batch: back to the queues' places; hits of rays that are done to their slots."""
    i = wp.tid()
    if i >= moved.count[0]:
        return
    position = moved.positions[i]
    if moved.where[i] != _DONE:
        copy_ray(work, position, values, moved.places[i])
        copy_progress(work, progress, position, values, stored, moved.places[i])
        return
    slot = moved.slots[i]
    home.hit_instance[slot] = work.hit_instance[position]
    if slot < moved.any_first:
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
def add_counts_kernel(counts: TraceCounts, moved: Moved, total: TraceCounts):
    """By ray of the batch: what was counted at its position is added to its slot."""
    i = wp.tid()
    if i < moved.count[0]:
        position, slot = moved.positions[i], moved.slots[i]
        total.node_steps[slot] = total.node_steps[slot] + counts.node_steps[position]
        total.box_tests[slot] = total.box_tests[slot] + counts.box_tests[position]
        total.triangle_tests[slot] = total.triangle_tests[slot] + counts.triangle_tests[position]
        total.treelet_visits[slot] = total.treelet_visits[slot] + counts.treelet_visits[position]
        total.queued[slot] = total.queued[slot] + counts.queued[position]


STORAGE_KERNELS = (store_new_kernel, load_kernel, store_kernel, reset_counts_kernel, add_counts_kernel)
# Bytes of a ray that are stored, without trail and entry: origin, direction, limit, instance, triangle, weights
VALUE_BYTES = 12 + 12 + 4 + 4 + 4 + 8


def _allocate_values(count: int, visibility: bool, device: wp.Device) -> Rays:
    values = Rays()
    with wp.ScopedDevice(device):
        values.origin, values.direction = wp.zeros(count, dtype=wp.vec3), wp.zeros(count, dtype=wp.vec3)
        values.t_max = values.hit_t = wp.zeros(count, dtype=float)
        values.visibility = wp.zeros(count if visibility else 0, dtype=int)
        values.hit_instance, values.hit_primitive = wp.zeros(count, dtype=int), wp.zeros(count, dtype=int)
        values.hit_uv = wp.zeros(count, dtype=wp.vec2)
    return values


class DirectStorage:
    """The values, and the memory of a batch."""

    def __init__(
        self, home: Rays, any_first: int, place_count: int, capacity: int, words: int, instancing: bool, counts: TraceCounts | None,
        device: wp.Device,
    ):  # fmt: skip
        """For rays of `home`; those from slot `any_first` on ask for any hit. Batches have at most `capacity` rays."""
        mixed = any_first < home.origin.size
        self._home, self._counts = home, counts
        self._launches = RepeatedLaunches(device)
        self._values = _allocate_values(place_count, home.visibility.size > 0, device)
        self._stored = allocate_progress(place_count, words, instancing, device)
        size = capacity * (2 if mixed else 1)
        self.rays = _allocate_values(size, home.visibility.size > 0, device)
        self.progress = allocate_progress(size, words, instancing, device)
        self.any_first = capacity if mixed else NO_ANY_HIT
        self._moved = Moved()
        self._moved.any_first, self._moved.capacity = any_first, capacity
        self._moved.positions = wp.zeros(capacity, dtype=int, device=device)
        self.places = wp.zeros(capacity, dtype=int, device=device)
        self._moved.places = self.places
        self.counts = None
        if counts is not None:
            self.counts = TraceCounts()
            for name in ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued"):
                setattr(self.counts, name, wp.zeros(size, dtype=int, device=device))
            self.counts.lanes = counts.lanes

    def store_new(self, batch: Batch) -> None:
        """Rays of `batch` have begun to wait at `places`."""
        self._fill(batch)
        self._launch(store_new_kernel, batch.bound, self._home, self._values, self._moved)
        if self._counts is not None:
            self._launch(reset_counts_kernel, batch.bound, self._counts, batch.slots, batch.count)

    def load(self, batch: Batch) -> Batch:
        """The rays of `batch`, which waited at `places`, as a batch of their positions in `rays`."""
        self._fill(batch)
        moved = self._moved
        self._launch(load_kernel, batch.bound, self._values, self._stored, self.rays, self.progress, moved)
        if self.counts is not None:
            self._launch(reset_counts_kernel, batch.bound, self.counts, moved.positions, batch.count)
        return Batch(moved.positions, batch.where, batch.count, batch.bound)

    def store(self, batch: Batch) -> None:
        """The rays of `batch` wait at `places` now, or are done."""
        self._fill(batch)
        self._launch(store_kernel, batch.bound, self.rays, self.progress, self._values, self._stored, self._home, self._moved)
        if self.counts is not None:
            self._launch(add_counts_kernel, batch.bound, self.counts, self._moved, self._counts)

    def _fill(self, batch: Batch) -> None:
        self._moved.slots, self._moved.where, self._moved.count = batch.slots, batch.where, batch.count

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        self._launches.launch(kernel, count, *inputs)
