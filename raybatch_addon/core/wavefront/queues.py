"""Lists of path slots by status, made by counting, exclusive scan and scatter: no locks, and always in slot order.

Two lists are made at a time: their counts share the halves of one 64-bit scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .tracer import SlotList


@wp.struct
class PairRule:
    """Which paths belong to the lists A and B: those with `status & mask == value`."""

    mask_a: int
    value_a: int
    change_a: int  # status bits that are flipped on the way
    slot_first_a: int  # added to the path's number
    mask_b: int
    value_b: int
    change_b: int
    slot_first_b: int
    b_has_a: int  # B takes the paths of A too
    place: int  # of the two counts


@wp.kernel(**KERNEL_OPTIONS)
def flag_kernel(status: wp.array(dtype=int), rule: PairRule, flags: wp.array(dtype=wp.int64)):
    """`flags` has 1 for list A, and 2^32 for list B."""
    slot = wp.tid()
    state = status[slot]
    flag = wp.int64(0)
    is_a = (state & rule.mask_a) == rule.value_a
    if is_a:
        flag = wp.int64(1)
    if (state & rule.mask_b) == rule.value_b or (is_a and rule.b_has_a != 0):
        flag = flag + wp.int64(4294967296)
    flags[slot] = flag


@wp.kernel(**KERNEL_OPTIONS)
def scatter_kernel(
    flags: wp.array(dtype=wp.int64),
    offsets: wp.array(dtype=wp.int64),
    rule: PairRule,
    status: wp.array(dtype=int),
    slots_a: wp.array(dtype=int),
    slots_b: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """Write flagged slots in order, flip the `change` bits of their status, and count them."""
    slot = wp.tid()
    flag = flags[slot]
    offset = offsets[slot]
    if flag != wp.int64(0):
        change = int(0)
        if (flag & wp.int64(1)) != wp.int64(0):
            slots_a[int(offset & wp.int64(0xFFFFFFFF))] = rule.slot_first_a + slot
            change = rule.change_a
        if flag > wp.int64(1):
            slots_b[int(offset >> wp.int64(32))] = rule.slot_first_b + slot
            change = change | rule.change_b
        if change != 0:
            status[slot] = status[slot] ^ change
    if slot == flags.shape[0] - 1:
        total = offset + flag
        counts[rule.place] = int(total & wp.int64(0xFFFFFFFF))
        counts[rule.place + 1] = int(total >> wp.int64(32))


QUEUE_KERNELS = (flag_kernel, scatter_kernel)


@dataclass(frozen=True)
class GatherRule:
    """Which paths belong to a list: those with `status & mask == value`."""

    mask: int
    value: int
    change: int = 0  # status bits that are flipped on the way
    slot_first: int = 0  # added to the path's number: 0 for extending rays, the path count for shadow rays


class Counts:
    """Lengths of all lists of a worker, side by side on the device, so that one copy brings them to the host."""

    def __init__(self, size: int, device: wp.Device):
        self.on_device = wp.zeros(size, dtype=int, device=device)
        # a CUDA device writes to memory that the host has pinned without a detour
        self._on_host = wp.zeros(size, dtype=int, device="cpu", pinned=True) if device.is_cuda else self.on_device

    def at(self, place: int) -> wp.array:
        """One count, int32, shape [1]."""
        return self.on_device[place : place + 1]

    def fetch(self) -> list[int]:
        """All of them, once the device is done with what it was told."""
        device = self.on_device.device
        if device.is_cuda:
            wp.copy(self._on_host, self.on_device)
            wp.synchronize_stream(device.stream)
        return self._on_host.numpy().tolist()


class Scratch:
    """Work arrays of `PairQueue.gather`, shared by the queues of one worker."""

    def __init__(self, path_count: int, device: wp.Device):
        self.flags = wp.zeros(path_count, dtype=wp.int64, device=device)
        self.offsets = wp.zeros(path_count, dtype=wp.int64, device=device)


class PairQueue:
    """Makes and holds two lists of slots."""

    def __init__(self, path_count: int, a: GatherRule, b: GatherRule, counts: Counts, place: int, b_has_a: bool = False):
        """Lists by the rules `a` and `b`; their lengths are `counts` number `place` and the next."""
        self._device = device = counts.on_device.device
        self._path_count = path_count
        self._slots = [wp.zeros(path_count, dtype=int, device=device) for _ in range(2)]
        self._counts, self._place = counts, place
        self._rule = PairRule()
        for name, rule in (("a", a), ("b", b)):
            for field in ("mask", "value", "change", "slot_first"):
                setattr(self._rule, f"{field}_{name}", getattr(rule, field))
        self._rule.b_has_a, self._rule.place = int(b_has_a), place

    def gather(self, status: wp.array, scratch: Scratch, bound: int) -> tuple[SlotList, SlotList]:
        """The paths that the rules pick; the caller knows that neither list is longer than `bound`."""
        count, (slots_a, slots_b) = self._path_count, self._slots
        wp.launch(flag_kernel, count, [status, self._rule, scratch.flags], device=self._device)
        wp.utils.array_scan(scratch.flags, scratch.offsets, inclusive=False)
        wp.launch(
            scatter_kernel, count,
            [scratch.flags, scratch.offsets, self._rule, status, slots_a, slots_b, self._counts.on_device],
            device=self._device,
        )  # fmt: skip
        lists = zip(self._slots, (self._counts.at(self._place), self._counts.at(self._place + 1)))
        return tuple(SlotList(slots, count, bound) for slots, count in lists)
