"""Lists of path slots by status, made by counting, exclusive scan and scatter: no locks, and always in slot order."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .tracer import SlotList


@wp.kernel(**KERNEL_OPTIONS)
def flag_kernel(status: wp.array(dtype=int), mask: int, value: int, flags: wp.array(dtype=int)):
    """`flags` is 1 where the masked status equals `value`."""
    slot = wp.tid()
    flag = int(0)
    if (status[slot] & mask) == value:
        flag = 1
    flags[slot] = flag


@wp.kernel(**KERNEL_OPTIONS)
def scatter_kernel(
    flags: wp.array(dtype=int),
    offsets: wp.array(dtype=int),
    change: int,
    slot_first: int,
    status: wp.array(dtype=int),
    slots: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """Write flagged slots in order, flip the `change` bits of their status, and count them."""
    slot = wp.tid()
    if flags[slot] != 0:
        slots[offsets[slot]] = slot_first + slot
        status[slot] = status[slot] ^ change
    if slot == flags.shape[0] - 1:
        counts[0] = offsets[slot] + flags[slot]


QUEUE_KERNELS = (flag_kernel, scatter_kernel)


@dataclass(frozen=True)
class GatherRule:
    """Which paths belong to a list: those with `status & mask == value`."""

    mask: int
    value: int
    change: int = 0  # status bits that are flipped on the way
    slot_first: int = 0  # added to the path's number: 0 for extending rays, the path count for shadow rays


class SlotQueue:
    """Makes and holds one list of slots."""

    def __init__(self, path_count: int, device: wp.Device):
        self._device = device
        self._path_count = path_count
        self._slots = wp.zeros(path_count, dtype=int, device=device)
        self._count = wp.zeros(1, dtype=int, device=device)

    def gather(self, status: wp.array, scratch: Scratch, rule: GatherRule, bound: int) -> SlotList:
        """The paths that `rule` picks; the caller knows that they are at most `bound`."""
        count = self._path_count
        wp.launch(flag_kernel, count, [status, rule.mask, rule.value, scratch.flags], device=self._device)
        wp.utils.array_scan(scratch.flags, scratch.offsets, inclusive=False)
        wp.launch(
            scatter_kernel, count,
            [scratch.flags, scratch.offsets, rule.change, rule.slot_first, status, self._slots, self._count],
            device=self._device,
        )  # fmt: skip
        return SlotList(self._slots, self._count, bound)

    def length(self) -> int:
        """Number of slots gathered last; waits for the device."""
        return int(self._count.numpy()[0])


class Scratch:
    """Work arrays of `SlotQueue.gather`, shared by the queues of one worker."""

    def __init__(self, path_count: int, device: wp.Device):
        self.flags = wp.zeros(path_count, dtype=int, device=device)
        self.offsets = wp.zeros(path_count, dtype=int, device=device)
