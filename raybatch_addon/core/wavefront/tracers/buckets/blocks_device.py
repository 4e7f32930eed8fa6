"""Queues of a device with many threads.

Every launch's size is known on the host and nothing is allocated, so a transaction may be captured as part of a loop.
The kernels run on the CPU too, for tests.
"""

from __future__ import annotations

import warp as wp

from ....rays import DeviceRayList
from .blocks import Blocks, Moves, QueueRule
from .put import (
    PUT_KERNELS,
    put_close_kernel,
    put_grow_kernel,
    put_key_kernel,
    put_overflow_kernel,
    put_place_kernel,
    put_run_kernel,
    put_state_kernel,
    spare_kernel,
    spare_list_kernel,
)
from .scan import Scan
from .take import (
    TAKE_KERNELS,
    mask_list_kernel,
    mask_range_kernel,
    take_amount_kernel,
    take_close_kernel,
    take_copy_kernel,
    take_flag_kernel,
    take_list_kernel,
    take_overflow_kernel,
    take_part_kernel,
    take_queue_kernel,
    take_state_kernel,
)


class DeviceQueues:
    """Launches the transactions; holds their scratch."""

    kernels = PUT_KERNELS + TAKE_KERNELS + Scan.kernels

    def __init__(self, blocks: Blocks, capacity: int, device: wp.Device):
        """For batches of at most `capacity` rays."""
        self._blocks, self._device = blocks, device
        self._queue_total, self._block_count = blocks.counts.size, blocks.owner.size
        overflow = blocks.overflow_queue.size
        self._key_bits = self._queue_total.bit_length()
        self._scan = Scan(device)
        self.moves = moves = Moves()

        def zeros(count: int) -> wp.array:
            return wp.zeros(count, dtype=int, device=device)

        moves.keys, moves.order, moves.total = zeros(2 * capacity), zeros(2 * capacity), zeros(1)
        for name in ("run_first", "run_end", "amount", "part", "mask"):
            setattr(moves, name, zeros(self._queue_total))
        moves.amount_first, moves.part_first = zeros(self._queue_total + 1), zeros(self._queue_total + 1)
        moves.listed = zeros(self._block_count)
        moves.flags, moves.flags_first = zeros(capacity if overflow else 0), zeros(capacity + 1 if overflow else 0)
        moves.spare, moves.spare_list = zeros(overflow), zeros(overflow)
        moves.spare_first = zeros(overflow + 1 if overflow else 0)

    def put(self, rule: QueueRule, rays: DeviceRayList, bound: int) -> None:
        """Put the first `count[0]` rays, of `bound` at most, into their queues."""
        blocks, moves = self._blocks, self.moves
        overflow = blocks.overflow_queue.size
        self._launch(put_key_kernel, bound, blocks, rule, rays, moves)
        wp.utils.radix_sort_pairs(moves.keys, moves.order, bound, 0, self._key_bits)
        self._launch(put_run_kernel, bound, blocks, moves, bound)
        self._launch(put_grow_kernel, self._queue_total, blocks, moves)
        self._scan.launch(moves.amount, moves.amount_first)
        self._launch(put_place_kernel, bound, blocks, rays, moves)
        if overflow:
            self._scan.launch(moves.flags[:bound], moves.flags_first)
            self._launch(spare_kernel, overflow, blocks, moves)
            self._scan.launch(moves.spare, moves.spare_first)
            self._launch(spare_list_kernel, overflow, moves)
            self._launch(put_overflow_kernel, bound, blocks, rays, moves)
        self._launch(put_close_kernel, self._queue_total, blocks, moves)
        self._launch(put_state_kernel, 1, blocks, moves, bound)

    def choose(self, chosen) -> int:
        """Mark queues as chosen: a `range`, a list of numbers, or None for all; how many they are."""
        if chosen is None:
            chosen = range(self._queue_total)
        if isinstance(chosen, range):
            self._launch(mask_range_kernel, len(chosen), self.moves, chosen.start, chosen.step)
        elif len(chosen):
            listed = wp.array(list(map(int, chosen)), dtype=int, device=self._device)
            self._launch(mask_list_kernel, len(chosen), self.moves, listed)
        return len(chosen)

    def take(self, rule: QueueRule, rays: DeviceRayList, bound: int, chosen_count: int) -> None:
        """Take rays of the `chosen_count` queues that are marked; the caller knows that they are `bound` at most."""
        blocks, moves = self._blocks, self.moves
        size, overflow = blocks.queue_size, blocks.overflow_queue.size
        self._launch(take_amount_kernel, self._queue_total, blocks, moves)
        self._scan.launch(moves.amount, moves.amount_first)
        self._launch(take_part_kernel, self._queue_total, blocks, rays, moves)
        self._scan.launch(moves.part, moves.part_first)
        self._launch(take_list_kernel, self._block_count, blocks, moves)
        taken = min(self._block_count, bound // size + chosen_count)
        self._launch(take_copy_kernel, taken * size, blocks, rule, rays, moves)
        if overflow:
            self._launch(take_flag_kernel, overflow, blocks, moves)
            self._scan.launch(moves.spare, moves.spare_first)
            self._launch(take_overflow_kernel, overflow, blocks, rule, rays, moves)
        self._launch(take_close_kernel, self._block_count, blocks, moves)
        self._launch(take_queue_kernel, self._queue_total, blocks, moves)
        self._launch(take_state_kernel, 1, blocks, rays, moves)

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        wp.launch(kernel, count, list(inputs), device=self._device)
