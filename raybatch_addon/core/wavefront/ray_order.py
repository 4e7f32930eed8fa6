"""In which lists, and in which order, the rays of a turn are traced: by class, sorted where that pays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ..report.timing import NoTimer, StageTimer, Stopwatch, cost_clock_of
from .bounce_split import SPLIT_CLASSES, BounceSplit, split_kernels
from .queues import Counts
from .ray_sort import RaySorter, sort_bytes_per_ray, sort_kernel
from .rays import RayKind, Rays
from .sort_policy import BOUNCE, CAMERA, SHADOW, SortPolicy
from .tracer import SlotList

# Trials of sorting begin when this many times the paths alive were begun: the first waves are all camera rays
ITEMS_FIRST = 4


def order_kernels(ray_sort: str, device: wp.Device) -> list[wp.Kernel]:
    """Everything that a `RayOrder` launches; nothing where rays are never sorted."""
    return [] if ray_sort == "OFF" else [sort_kernel(device), *split_kernels(device)]


def order_bytes_per_path(ray_sort: str, is_cuda: bool) -> int:
    """Device memory of a `RayOrder` for each path alive [bytes]."""
    if ray_sort == "OFF":
        return 0
    lists = 3 * 4 + (2 * 8 if is_cuda else 0)  # by bounce, with two work arrays of the scan on CUDA
    return sort_bytes_per_ray(is_cuda) + lists


class RayOrder:
    """The order of one worker's rays."""

    def __init__(self, mode: str, path_count: int, box: np.ndarray, counts: Counts, place: int, timer: StageTimer | NoTimer):
        """`mode` is the setting `ray_sort`; `box`, two corners [m], holds the surfaces; `counts` from `place` on takes three lengths."""
        device = counts.on_device.device
        self.policy = SortPolicy(mode, ITEMS_FIRST * path_count)
        self._split = BounceSplit(path_count, counts.on_device, place)
        self._sorter = RaySorter(path_count, device, *box)
        self._watch = Stopwatch(cost_clock_of(device))
        self._timer = timer
        self._place = place
        self._parts: list[SlotList] | None = None  # of the list of scattered rays `_whole`
        self._whole: wp.array | None = None

    def split(self, bounced: SlotList, bounce: wp.array, items_begun: int) -> None:
        """Cut the list of scattered rays by their bounce, where these are treated apart; `bounce` is that of each path."""
        self._parts, self._whole = None, bounced.slots
        if not self.policy.treats_alike(SPLIT_CLASSES, items_begun):
            self._parts = self._split.split(bounced, bounce)

    def told(self, counts: list[int]) -> None:
        """The lengths of all lists have come to the host."""
        if self._parts:
            lengths = counts[self._place : self._place + len(self._parts)]
            self._parts = [SlotList(part.slots, part.count, length) for part, length in zip(self._parts, lengths)]

    def trace(self, kind: RayKind, listed: SlotList, rays: Rays, items_begun: int, launch: Callable[[SlotList], None]) -> None:
        """Call `launch` with lists that hold the rays of `listed`."""
        for ray_class, part in self._classes(kind, listed):
            if part.bound == 0:
                continue
            sorts = self.policy.choose(ray_class, part.bound, items_begun)
            measured = self.policy.is_measured(ray_class)
            if measured:
                self._watch.start((ray_class, sorts, part.bound))
            if sorts:
                with self._timer.stage("sort"):
                    part = self._sorter.sort(rays, part)
            launch(part)
            if measured:
                self._watch.stop()
        for (ray_class, was_sorted, ray_count), seconds in self._watch.take():
            self.policy.record(ray_class, was_sorted, ray_count, seconds)

    def _classes(self, kind: RayKind, listed: SlotList) -> list[tuple[str, SlotList]]:
        if kind != RayKind.CLOSEST:
            return [(SHADOW, listed)]
        if listed.coherent:
            return [(CAMERA, listed)]
        if self._parts is None or listed.slots is not self._whole:
            return [(BOUNCE, listed)]
        return list(zip(SPLIT_CLASSES, self._parts))
