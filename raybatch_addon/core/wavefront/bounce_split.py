"""Cuts a list of scattered rays into three by how often their paths have scattered, so that sorting can be decided for each.

On CUDA by counting, exclusive scan and scatter: two counts share the halves of one 64-bit scan, and a ray's place in the third list
is what the other two leave. On the CPU in one pass. Rays keep their order.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .sort_policy import BOUNCE_1, BOUNCE_2, BOUNCE_LATER

if TYPE_CHECKING:
    from .tracer import SlotList

# The lists, in their order: paths that have scattered once (or not yet, and only passed what is transparent), twice, more often
SPLIT_CLASSES = (BOUNCE_1, BOUNCE_2, BOUNCE_LATER)


@wp.struct
class SplitLists:
    """The three lists and their lengths."""

    slots: wp.array2d(dtype=int)  # shape [3, capacity]
    counts: wp.array(dtype=int)
    place: int  # of the first of the three counts


@wp.func
def class_of(bounce: wp.array(dtype=int), slot: int) -> int:
    """Number of the list that the ray of `slot` belongs to."""
    path = slot
    if path >= bounce.shape[0]:
        path = path - bounce.shape[0]  # a shadow ray
    return wp.clamp(bounce[path], 1, 3) - 1


@wp.kernel(**KERNEL_OPTIONS)
def split_flag_kernel(bounce: wp.array(dtype=int), slots: wp.array(dtype=int), count: wp.array(dtype=int), flags: wp.array(dtype=wp.int64)):
    """`flags` has 1 for the first list and 2^32 for the second."""
    i = wp.tid()
    flag = wp.int64(0)
    if i < count[0]:
        place = class_of(bounce, slots[i])
        if place < 2:
            flag = wp.int64(1) << wp.int64(32 * place)
    flags[i] = flag


@wp.kernel(**KERNEL_OPTIONS)
def split_scatter_kernel(
    bounce: wp.array(dtype=int), slots: wp.array(dtype=int), count: wp.array(dtype=int), flags: wp.array(dtype=wp.int64),
    offsets: wp.array(dtype=wp.int64), lists: SplitLists,
):  # fmt: skip
    """Write every ray to its list, and the lengths."""
    i = wp.tid()
    offset = offsets[i]
    if i < count[0]:
        slot = slots[i]
        first, second = int(offset & wp.int64(0xFFFFFFFF)), int(offset >> wp.int64(32))
        place = class_of(bounce, slot)
        index = wp.where(place == 0, first, wp.where(place == 1, second, i - first - second))
        lists.slots[place, index] = slot
    if i == flags.shape[0] - 1:
        total = offset + flags[i]
        first, second = int(total & wp.int64(0xFFFFFFFF)), int(total >> wp.int64(32))
        lists.counts[lists.place] = first
        lists.counts[lists.place + 1] = second
        lists.counts[lists.place + 2] = count[0] - first - second


@wp.kernel(**KERNEL_OPTIONS)
def host_split_kernel(bounce: wp.array(dtype=int), slots: wp.array(dtype=int), count: wp.array(dtype=int), lists: SplitLists):
    """For the CPU, launched once for a whole list."""
    for place in range(3):
        lists.counts[lists.place + place] = 0
    for i in range(count[0]):
        slot = slots[i]
        place = class_of(bounce, slot)
        length = lists.counts[lists.place + place]
        lists.slots[place, length] = slot
        lists.counts[lists.place + place] = length + 1


def split_kernels(device: wp.Device) -> tuple[wp.Kernel, ...]:
    """The kernels that a `BounceSplit` launches on `device`."""
    return (split_flag_kernel, split_scatter_kernel) if device.is_cuda else (host_split_kernel,)


class BounceSplit:
    """Makes and holds the three lists of one worker."""

    def __init__(self, capacity: int, counts: wp.array, place: int):
        """Lists of at most `capacity` rays, whose lengths go to `counts[place : place + 3]`, int32, on the device."""
        self._device = device = counts.device
        self._lists = SplitLists()
        self._lists.slots = wp.zeros((3, capacity), dtype=int, device=device)
        self._lists.counts, self._lists.place = counts, place
        scratch = capacity if device.is_cuda else 0
        self._flags = wp.zeros(scratch, dtype=wp.int64, device=device)
        self._offsets = wp.zeros(scratch, dtype=wp.int64, device=device)

    def split(self, listed: SlotList, bounce: wp.array) -> list[SlotList]:
        """The rays of `listed` by `SPLIT_CLASSES`; `bounce`, int32, is that of each path."""
        bound, lists = listed.bound, self._lists
        if bound == 0:
            return [listed] * 3
        inputs = [bounce, listed.slots, listed.count]
        if self._device.is_cuda:
            flags, offsets = self._flags[:bound], self._offsets[:bound]
            wp.launch(split_flag_kernel, bound, [*inputs, flags], device=self._device)
            wp.utils.array_scan(flags, offsets, inclusive=False)
            wp.launch(split_scatter_kernel, bound, [*inputs, flags, offsets, lists], device=self._device)
        else:
            wp.launch(host_split_kernel, 1, [*inputs, lists], device=self._device)
        counts = [lists.counts[lists.place + k : lists.place + k + 1] for k in range(3)]
        return [dataclasses.replace(listed, slots=lists.slots[k], count=counts[k]) for k in range(3)]
