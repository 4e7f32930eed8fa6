"""Rays that are under way in a tracer that streams: where each is, taking those that can go on, and handing back the
finished.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ....bvh.tree import DONE, NEW
from ....native.structs import to_numpy
from ....rays import DeviceRayList, RayList
from .kernels import (
    CHUNKS_MOST,
    CLASS_IDLE,
    CLASS_PAGES,
    IDLE,
    SCAN_THREADS,
    SLOTS_A_TURN,
    TALLY_COPIES,
    Waiting,
    put_kernel,
    submit_kernel,
    take_kernels,
    tally_kernel,
)

_WARP = 32
# A batch holds this share of all rays at most, and lists of finished ones too, or so many: what bounds their memory
_BATCH_SHARE = 16
_BATCH_LEAST = 1 << 20
_SECOND_ALL = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class RayCounts:
    """How many rays are where."""

    idle: int
    new: int
    done_closest: int
    done_shadow: int
    waiting: np.ndarray  # by page, int64
    taken: int  # rays of the last batch; 0 once others were handed back
    visits: int  # of rays to treelets, so far

    @property
    def done(self) -> int:
        """Finished, and not handed back yet."""
        return self.done_closest + self.done_shadow


@dataclass(frozen=True)
class PendingCounts:
    """Counts on their way to the host."""

    values: wp.array
    arrived: wp.Event | None

    def read(self) -> RayCounts:
        """The counts, once they are there."""
        if self.arrived is not None:
            wp.synchronize_event(self.arrived)
        values = to_numpy(self.values)
        idle, new, closest, shadow = values[:CLASS_PAGES].tolist()
        return RayCounts(
            idle=idle,
            new=new,
            done_closest=closest,
            done_shadow=shadow,
            waiting=values[CLASS_PAGES:-2].copy(),
            taken=int(values[-2]),
            visits=int(values[-1]),
        )


def page_batch_capacity(slot_count: int) -> int:
    """Rays of a batch, and of a list of finished ones, at most."""
    return min(slot_count, max(_BATCH_LEAST, -(-slot_count // _BATCH_SHARE)))


def streaming_bytes_per_slot(slot_count: int) -> float:
    """Device memory of `WaitingRays` for each ray slot [bytes]."""
    return 4 + 8 * page_batch_capacity(slot_count) / slot_count


class WaitingRays:
    """All rays of one worker that are under way, by slot."""

    def __init__(
        self,
        slot_count: int,
        shadow_first: int,
        page_of: wp.array,
        page_count: int,
        device: wp.Device,
        capacity: int = 0,
    ):
        """`page_of` is the page of every treelet; slots from `shadow_first` on hold shadow rays. Batches hold
        `capacity` rays at most (0: `page_batch_capacity`)."""
        self._device, self._slot_count, self._shadow_first = device, slot_count, shadow_first
        self.capacity = min(slot_count, capacity) if capacity else page_batch_capacity(slot_count)
        self._page_of = page_of
        self._classes = CLASS_PAGES + page_count
        cuda = device.is_cuda
        waiting = self._waiting = Waiting()
        waiting.location = wp.empty(slot_count, dtype=int, device=device)
        waiting.page = page_of
        waiting.classes, waiting.copies = self._classes, TALLY_COPIES if cuda else 1
        waiting.tally = wp.empty(waiting.classes * waiting.copies, dtype=int, device=device)
        waiting.shadow_first = shadow_first
        waiting.chunk = SLOTS_A_TURN * -(-slot_count // (SLOTS_A_TURN * CHUNKS_MOST))
        waiting.parts = wp.zeros(-(-slot_count // waiting.chunk) if cuda else 0, dtype=wp.uint64, device=device)
        self._batch, self._done = DeviceRayList(), DeviceRayList()
        self._batch.count, self._done.count = (
            wp.zeros(3, dtype=int, device=device),
            wp.zeros(3, dtype=int, device=device),
        )
        self._batch_count = self._batch.count[:1]
        self._closest_count, self._shadow_count = self._done.count[1:2], self._done.count[2:3]
        # rays are handed back when no batch is under way
        self._batch.slots = self._done.slots = wp.zeros(self.capacity, dtype=int, device=device)
        self._batch.locations, self._done.locations = (
            wp.zeros(self.capacity, dtype=int, device=device),
            wp.zeros(0, dtype=int, device=device),
        )
        self._totals = wp.zeros(self._classes + 2, dtype=wp.int64, device=device)
        # as many as are on their way to the host at once
        self._on_host = [wp.zeros(self._totals.shape, dtype=wp.int64, device="cpu", pinned=cuda) for _ in range(4)]
        self._turn = 0
        self.clear()

    def clear(self) -> None:
        """No slot has a ray."""
        self._waiting.location.fill_(IDLE)
        self._waiting.tally.zero_()
        self._waiting.tally[CLASS_IDLE : CLASS_IDLE + 1].fill_(self._slot_count)

    def submit(self, rays: RayList) -> None:
        """Rays come in."""
        wp.launch(submit_kernel, rays.bound, [self._waiting, rays.slots, rays.count], device=self._device)

    def take(self, there: wp.array, new_most: int, bound: int) -> RayList:
        """Rays whose treelets are `there` (their addresses, by treelet), and at most `new_most` new ones; `bound` is
        known to be at least how many there can be. They are to be `put` back before any others are taken."""
        self._take(True, there, self._batch, new_most)
        batch = self._batch
        return RayList(batch.slots, self._batch_count, max(1, min(self.capacity, bound)), batch.locations)

    def put(self, batch: RayList) -> None:
        """The rays of the batch that was taken last are where it says now."""
        threads = -(-batch.bound // _WARP) * _WARP if self._device.is_cuda else 1
        wp.launch(put_kernel(), threads, [self._waiting, self._batch], device=self._device)

    def take_done(self, counts: RayCounts) -> list[tuple[bool, RayList]]:
        """Finished rays, whose slots are idle from now on: (whether they are shadow rays, their list). `counts` must be
        up to date. Lists are valid until rays are taken again; what they do not hold is left for the next call."""
        if not counts.done:
            return []
        closest = min(counts.done_closest, self.capacity)
        shadow = min(counts.done_shadow, self.capacity - closest)
        self._take(False, None, self._done, _SECOND_ALL)
        done, lists = self._done, []
        if closest:
            lists.append((False, RayList(done.slots[:closest], self._closest_count, closest)))
        if shadow:
            lists.append((True, RayList(done.slots[closest : closest + shadow], self._shadow_count, shadow)))
        return lists

    def count(self, visits: wp.array) -> PendingCounts:
        """How many rays are where, once the device has come to this point."""
        wp.launch(
            tally_kernel, self._classes + 2, [self._waiting, self._batch, visits, self._totals], device=self._device
        )
        self._turn = (self._turn + 1) % len(self._on_host)
        values = self._on_host[self._turn]
        wp.copy(values, self._totals)
        return PendingCounts(values, self._device.stream.record_event() if self._device.is_cuda else None)

    def check(self, counts: RayCounts) -> None:
        """Every slot is in one class, and the counts agree; raises AssertionError that says what is wrong."""
        location, page_of = to_numpy(self._waiting.location), to_numpy(self._page_of)
        known = location.min() >= IDLE and location.max() < len(page_of)
        assert known, f"a ray waits for treelet {location.max()} of {len(page_of)}, or in {location.min()}"
        found = np.bincount(page_of[location[location >= 0]], minlength=self._classes - CLASS_PAGES)
        done, shadow = location == DONE, np.arange(len(location)) >= self._shadow_first
        counted = {
            "idle": (counts.idle, (location == IDLE).sum()),
            "new": (counts.new, (location == NEW).sum()),
            "done": (counts.done_closest, (done & ~shadow).sum()),
            "done shadow": (counts.done_shadow, (done & shadow).sum()),
            "waiting": (counts.waiting.tolist(), found.tolist()),
        }
        wrong = {name: pair for name, pair in counted.items() if pair[0] != pair[1]}
        assert not wrong, f"counts of rays and rays differ (counted, found): {wrong}"
        slots = to_numpy(self._batch.slots)[: counts.taken]
        assert len(np.unique(slots)) == len(slots), "a ray was taken twice"

    def check_idle(self, rays: RayList) -> None:
        """The slots that are listed hold none of these rays, and each stands there once."""
        slots = to_numpy(rays.slots)[: int(to_numpy(rays.count)[0])]
        busy = to_numpy(self._waiting.location)[slots] != IDLE
        assert not busy.any(), (
            f"{busy.sum()} rays come in that are under way already, the first in slot {slots[busy][0]}"
        )
        assert len(np.unique(slots)) == len(slots), "a ray comes in twice at once"

    def _take(self, ready: bool, there: wp.array | None, taken: DeviceRayList, second_most: int) -> None:
        count, scan, scatter = take_kernels(ready)
        inputs = [self._waiting, there, taken, second_most]
        if self._device.is_cuda:
            threads = _WARP * self._waiting.parts.size
            wp.launch(count, threads, inputs, device=self._device)
            wp.launch(scan, SCAN_THREADS, inputs, device=self._device, block_dim=SCAN_THREADS)
            wp.launch(scatter, threads, inputs, device=self._device)
        else:
            wp.launch(scatter, 1, inputs, device=self._device)
