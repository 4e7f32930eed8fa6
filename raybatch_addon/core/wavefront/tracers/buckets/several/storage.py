"""Storage of rays that wait at several treelets: copies of each, and queues of their numbers."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from .....bvh.traverse.counts import TraceCounts, counts_of
from .....bvh.tree import Tree
from .....device.launches import RepeatedLaunches
from .....native.structs import to_numpy
from .....rays import NO_ANY_HIT, DeviceRayList, RayList, Rays
from ....rays import RayNeeds, allocate_progress, allocate_rays
from ..blocks import QueueRule
from ..queues import BucketQueues
from ..storage import InPlace
from .kernels import (
    COPY_KERNELS,
    Copies,
    add_copy_counts_kernel,
    begin_copies_kernel,
    enter_copies_kernel,
    gather_copies_kernel,
    hand_back_kernel,
    leave_copies_kernel,
    reset_copy_counts_kernel,
    send_copies_kernel,
    spread_copies_kernel,
)


class RayCopies(InPlace):
    """Every ray has `width` places (`kernels.py`), and queues hold numbers of places, at which rays are traced."""

    kernels: ClassVar[tuple[wp.Kernel, ...]] = COPY_KERNELS

    def __init__(
        self,
        queues: BucketQueues,
        home: Rays,
        any_first: int,
        words: int,
        instancing: bool,
        moving: bool,
        counts: TraceCounts | None,
        *,
        width: int,
        tree: Tree,
    ):
        """As `ByValue`, for rays that meet `tree`, with `width` places for each; `queues` are of places."""
        device, places, capacity = queues.device, queues.slot_count, queues.capacity
        self._queues, self._home, self._home_counts, self._tree, self._taken = queues, home, counts, tree, None
        self._launches = RepeatedLaunches(device)
        needs = RayNeeds(limits=False, visibility=home.visibility.size > 0, time=moving)
        self.rays, self.progress = (
            allocate_rays(places, device, needs),
            allocate_progress(places, words, instancing, device),
        )
        self.any_first = NO_ANY_HIT if any_first == NO_ANY_HIT else any_first * width
        self.width = width
        self._copies = copies = Copies()
        copies.width, copies.any_first = width, self.any_first
        for name, count in (("waiting", 1), ("used", 1), ("ended", 1), ("last", 1), ("at", width)):
            setattr(copies, name, wp.zeros(places // width * count, dtype=int, device=device))
        copies.best = wp.zeros(places // width, dtype=float, device=device)
        self._begun = wp.zeros(capacity, dtype=int, device=device)
        self._locations = wp.zeros((width - 1, capacity), dtype=int, device=device)
        self._places = wp.zeros((width - 1, capacity), dtype=int, device=device)
        # of each pass; views that stay, so that launches find the same objects
        self._lists = [(self._places[k], self._locations[k]) for k in range(width - 1)]
        self._batches = [DeviceRayList() for _ in range(width)]
        self.counts = None
        if counts is not None:
            self.counts = counts_of(places, device, waits=True)
            self.counts.lanes = counts.lanes

    @staticmethod
    def bytes_per_slot(progress_bytes: int, instancing: bool, moving: bool, entry_share: float) -> float:
        """Of each place: the ray, its progress, and what `Copies` and lists of copies have of it at most."""
        needs = RayNeeds(limits=False, visibility=instancing, time=moving)
        return progress_bytes + needs.bytes_per_path + 8 * 4

    def begin(self, batch: RayList, rule: QueueRule) -> None:
        """The first copies of new rays wait in queues."""
        for first in range(0, batch.bound, self._queues.capacity):
            part = self._queues.part(batch, first)
            listed = self._listed(0, part)
            self._launch(begin_copies_kernel, part.bound, self._home, self._copies, self.rays, listed, self._begun)
            if self.counts is not None:
                self._launch(reset_copy_counts_kernel, part.bound, self.counts, self.width, part.slots, part.count)
            self._queues.put(RayList(self._begun, part.count, part.bound, self._begun), rule)

    def finished(self, batch: RayList) -> RayList:
        """See `Storage.finished`."""
        self._launch(hand_back_kernel, batch.bound, self._copies, batch.slots, batch.count)
        return batch

    def under_way(self, waiting: int) -> int:
        """See `Storage.under_way`."""
        return int(np.count_nonzero(to_numpy(self._copies.waiting)))

    def clear(self) -> None:
        """See `Storage.clear`."""
        self._copies.waiting.zero_()

    # --- of the batch that was taken last

    def spread(self, batch: RayList, k: int) -> RayList:
        """The copies behind those of `batch`, the kth ones, which go on from where these came to a treelet."""
        places, locations = self._lists[k]
        listed = self._listed(k, batch)
        self._launch(
            spread_copies_kernel, batch.bound, self._copies, self.rays, self.progress, listed, places, locations
        )
        return RayList(places, batch.count, batch.bound, locations)

    def send(self, batch: RayList, passes: int) -> None:
        """Behind the top level: first copies are those of `batch`, and `passes` others were spread."""
        inputs = self._home, self._copies, self.rays, self._listed(0, batch), self._locations, passes
        self._launch(send_copies_kernel, batch.bound, *inputs)
        self._add_counts(batch)

    def put_spread(self, passes: int, rule: QueueRule) -> None:
        """Put the copies that were spread into queues."""
        for places, locations in self._lists[:passes]:
            batch = self._taken
            self._queues.put(RayList(places, batch.count, batch.bound, locations), rule)

    def enter(self, batch: RayList) -> None:
        """Before treelets are visited."""
        self._launch(enter_copies_kernel, batch.bound, self._copies, self.rays, self._listed(0, batch))

    def leave(self, batch: RayList) -> None:
        """Behind treelets: the batch has first copies of rays that are to go on, or done; others are parked."""
        listed = self._listed(0, batch)
        self._launch(leave_copies_kernel, batch.bound, self._copies, self.rays, listed)
        inputs = self._home, self._tree, self._copies, self.rays, self.progress, listed
        self._launch(gather_copies_kernel, batch.bound, *inputs)
        self._add_counts(batch)

    def _add_counts(self, batch: RayList) -> None:
        if self.counts is not None:
            listed = self._listed(0, batch)
            self._launch(add_copy_counts_kernel, batch.bound, self.counts, self.width, listed, self._home_counts)

    def _listed(self, k: int, batch: RayList) -> DeviceRayList:
        listed = self._batches[k]
        listed.slots, listed.count = batch.slots, batch.count
        if batch.locations is not None:
            listed.locations = batch.locations
        return listed

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        self._launches.launch(kernel, count, *inputs)
