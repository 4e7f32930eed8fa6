"""In which lists, and in which order, the rays of a turn are traced: by class, sorted where that pays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import warp as wp

from ...measure.timing import NoTimer, StageTimer, Stopwatch, cost_clock_of
from ...rays import RayKind, RayList, Rays
from .ray_sort import RaySorter, sort_bytes_per_ray, sort_kernel
from .sort_policy import BOUNCE, BOUNCE_1, BOUNCE_2, BOUNCE_LATER, CAMERA, SHADOW, SortPolicy

# Trials of sorting begin when this many times the paths alive were begun: the first waves are all camera rays
ITEMS_FIRST = 4
# Rays that are sorted at a time, so that sorting takes no more memory however many are alive; longer lists are sorted
# in parts
CPU_SORTED_MAX, CUDA_SORTED_MAX = 1 << 18, 1 << 22
# The parts of the list of scattered rays that are sorted or not each by itself
SPLIT_CLASSES = (BOUNCE_1, BOUNCE_2, BOUNCE_LATER)


def order_kernels(ray_sort: str, device: wp.Device) -> list[wp.Kernel]:
    """Everything that a `RayOrder` launches; nothing where rays are never sorted."""
    return [] if ray_sort == "OFF" else [sort_kernel(device)]


def order_bytes(ray_sort: str, path_count: int, is_cuda: bool) -> int:
    """Device memory that a `RayOrder` of so many paths takes at most: when it sorts first [bytes]."""
    return 0 if ray_sort == "OFF" else _sorted_max(path_count, is_cuda) * sort_bytes_per_ray(is_cuda)


def _sorted_max(path_count: int, is_cuda: bool) -> int:
    return min(path_count, CUDA_SORTED_MAX if is_cuda else CPU_SORTED_MAX)


class RayOrder:
    """The order of one worker's rays."""

    def __init__(self, mode: str, path_count: int, box: np.ndarray, device: wp.Device, timer: StageTimer | NoTimer):
        """`mode` is the setting `ray_sort`; `box`, two corners [m], holds the surfaces."""
        self._mode, self._path_count, self._box, self._device = mode, path_count, box, device
        self._sorted_max = _sorted_max(path_count, device.is_cuda)
        self._sorter: RaySorter | None = None  # made when rays are sorted first
        self._watch = Stopwatch(cost_clock_of(device))
        self._timer = timer
        self.begin()

    def begin(self) -> None:
        """A render begins, of which nothing is known."""
        self.policy = SortPolicy(self._mode, ITEMS_FIRST * self._path_count)
        self._items_begun = 0
        self._parts: list[RayList] = []  # of the list of scattered rays `_whole`
        self._whole: wp.array | None = None

    def note_begun(self, items_begun: int) -> None:
        """Paths begun so far in all: the policy goes by them."""
        self._items_begun = items_begun

    def wants_parts(self) -> bool:
        """Whether scattered rays are to be listed by bounce, because these are treated apart."""
        return not self.policy.treats_alike(SPLIT_CLASSES, self._items_begun)

    def note_bounced(self, bounced: RayList, parts: list[RayList]) -> None:
        """Scattered rays of the next turn, in one list, and by `SPLIT_CLASSES` if that was wanted."""
        self._whole, self._parts = bounced.slots, parts

    def parts(self, kind: RayKind, listed: RayList, rays: Rays) -> Iterator[RayList]:
        """Lists that hold the rays of `listed`. Each is to be traced before the next one is asked for: what that takes
        may be measured, and the next one may be sorted into the same memory.
        """
        for ray_class, part in self._classes(kind, listed):
            if part.bound == 0:
                continue
            sorts = self.policy.choose(ray_class, part.bound, self._items_begun)
            measured = self.policy.is_measured(ray_class)
            if measured:
                self._watch.start((ray_class, sorts, part.bound))
            if sorts:
                yield from self._sorted(rays, part)
            else:
                yield part
            if measured:
                self._watch.stop()
        for (ray_class, was_sorted, ray_count), seconds in self._watch.take():
            self.policy.record(ray_class, was_sorted, ray_count, seconds)

    def _sorted(self, rays: Rays, listed: RayList) -> Iterator[RayList]:
        if self._sorter is None:
            self._sorter = RaySorter(self._sorted_max, self._device, *self._box)
        for part in self._sorter.parts(listed):
            with self._timer.stage("sort"):
                part = self._sorter.sort(rays, part)
            yield part

    def _classes(self, kind: RayKind, listed: RayList) -> list[tuple[str, RayList]]:
        if kind != RayKind.CLOSEST:
            return [(SHADOW, listed)]
        if listed.coherent:
            return [(CAMERA, listed)]
        if not self._parts or listed.slots is not self._whole:
            return [(BOUNCE, listed)]
        return list(zip(SPLIT_CLASSES, self._parts))
