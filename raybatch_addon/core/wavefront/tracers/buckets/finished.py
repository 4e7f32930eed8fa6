"""Rays that are done, apart by kind: those that extend paths, and shadow rays."""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....device.launches import RepeatedLaunches
from ....native.structs import to_numpy
from ....rays import RayKind, RayList
from .scan import Scan


@wp.kernel(**KERNEL_OPTIONS)
def split_flag_kernel(
    slots: wp.array(dtype=int), count: wp.array(dtype=int), path_count: int, flags: wp.array(dtype=int)
):
    """By ray: 1 for rays that extend paths."""
    i = wp.tid()
    flag = int(0)
    if i < count[0]:
        flag = wp.where(slots[i] < path_count, 1, 0)
    flags[i] = flag


@wp.kernel(**KERNEL_OPTIONS)
def split_kernel(
    slots: wp.array(dtype=int),
    count: wp.array(dtype=int),
    flags: wp.array(dtype=int),
    first: wp.array(dtype=int),
    lists: wp.array2d(dtype=int),
    lengths: wp.array(dtype=int),
    bound: int,
):
    """By ray: it goes to one of two lists; every list keeps the order."""
    i = wp.tid()
    if i < count[0]:
        if flags[i] != 0:
            lists[0, first[i]] = slots[i]
        else:
            lists[1, i - first[i]] = slots[i]
    if i == 0:
        lengths[0] = first[bound]
        lengths[1] = count[0] - first[bound]


SPLIT_KERNELS = (*Scan.kernels, split_flag_kernel, split_kernel)


class FinishedLists:
    """Splits batches; the lists are overwritten by the next one."""

    def __init__(self, capacity: int, path_count: int, shadow_kind: RayKind, device: wp.Device):
        """`capacity`: rays of a batch at most. Rays in slots from `path_count` on are of `shadow_kind`."""
        self._path_count, self._kinds = path_count, (RayKind.CLOSEST, shadow_kind)
        self._launches, self._scan = RepeatedLaunches(device), Scan(device)
        self._flags = wp.zeros(capacity, dtype=int, device=device)
        self._firsts = wp.zeros(capacity + 1, dtype=int, device=device)  # rays that extend paths before each ray
        self._lists = wp.zeros((2, capacity), dtype=int, device=device)
        self._lengths = wp.zeros(2, dtype=int, device=device)

    def split(self, batch: RayList) -> None:
        """Launch the split of `batch`."""
        bound = batch.bound
        inputs = [batch.slots, batch.count]
        self._launches.launch(split_flag_kernel, bound, *inputs, self._path_count, self._flags)
        self._scan.launch(self._flags[:bound], self._firsts)
        self._launches.launch(
            split_kernel, bound, *inputs, self._flags, self._firsts, self._lists, self._lengths, bound
        )

    def fetch(self) -> list[tuple[RayKind, RayList]]:
        """The lists that have rays; waits for the device."""
        lengths = to_numpy(self._lengths).tolist()
        return [
            (kind, RayList(self._lists[k], self._lengths[k : k + 1], length))
            for k, (kind, length) in enumerate(zip(self._kinds, lengths))
            if length
        ]
