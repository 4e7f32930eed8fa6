"""Rays are put into queues by many threads: sorted by queue, counted, and scattered to entries of the pool that follow
from sums.
"""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....rays import DeviceRayList
from .blocks import FREE, IN_USE_PEAK, OVERFLOW, SHORT, STEP, WAITING, Blocks, Moves, QueueRule, blocks_for, queue_of


@wp.kernel(**KERNEL_OPTIONS)
def put_key_kernel(blocks: Blocks, rule: QueueRule, rays: DeviceRayList, moves: Moves):
    """By ray of the batch."""
    i = wp.tid()
    key = blocks.counts.shape[0]
    if i < rays.count[0]:
        queue = queue_of(rule, rays.locations[i])
        if queue >= 0:
            key = queue
        if rays.pool_index.shape[0] > 0:
            rays.pool_index[i] = -1
    moves.keys[i] = key
    moves.order[i] = i
    if i == 0:
        moves.total[0] = 0


@wp.kernel(**KERNEL_OPTIONS)
def put_run_kernel(blocks: Blocks, moves: Moves, bound: int):
    """By sorted ray: where the rays of each queue begin and end."""
    i = wp.tid()
    queue_total = blocks.counts.shape[0]
    queue = moves.keys[i]
    if queue >= queue_total:
        return
    if i == 0 or moves.keys[i - 1] != queue:
        moves.run_first[queue] = i
    follower = int(queue_total)
    if i + 1 < bound:
        follower = moves.keys[i + 1]
    if follower != queue:
        moves.run_end[queue] = i + 1
    if follower >= queue_total:
        moves.total[0] = i + 1


@wp.kernel(**KERNEL_OPTIONS)
def put_grow_kernel(blocks: Blocks, moves: Moves):
    """By queue: the blocks that it needs more."""
    queue = wp.tid()
    added = moves.run_end[queue] - moves.run_first[queue]
    filled = blocks.in_blocks[queue]
    more = int(0)
    if added > 0:
        more = blocks_for(filled + added, blocks.queue_size) - blocks_for(filled, blocks.queue_size)
    moves.amount[queue] = more


@wp.kernel(**KERNEL_OPTIONS)
def put_place_kernel(blocks: Blocks, rays: DeviceRayList, moves: Moves):
    """By sorted ray: it goes to its entry of the pool."""
    i = wp.tid()
    queue = moves.keys[i]
    over = int(0)
    if queue < blocks.counts.shape[0]:
        size = blocks.queue_size
        filled = blocks.in_blocks[queue]
        position = filled + i - moves.run_first[queue]
        number = position // size
        had = blocks_for(filled, size)
        block = int(-1)
        if number < had:
            block = blocks.open[queue]
        else:
            taken = moves.amount_first[queue] + number - had
            free = blocks.state[FREE]
            if taken < free:
                block = blocks.free[free - 1 - taken]
        if block < 0:
            over = 1
        else:
            offset = position % size
            if offset == 0:
                blocks.owner[block] = queue
                blocks.link[block] = number
            pool_index = block * size + offset
            index = moves.order[i]
            blocks.slots[pool_index] = rays.slots[index]
            if rays.pool_index.shape[0] > 0:
                rays.pool_index[index] = pool_index
    if moves.flags.shape[0] > 0:
        moves.flags[i] = over


@wp.kernel(**KERNEL_OPTIONS)
def spare_kernel(blocks: Blocks, moves: Moves):
    """By entry of the overflow: whether it is free."""
    i = wp.tid()
    moves.spare[i] = wp.where(blocks.overflow_queue[i] < 0, 1, 0)


@wp.kernel(**KERNEL_OPTIONS)
def spare_list_kernel(moves: Moves):
    """By entry of the overflow: list those that are free."""
    i = wp.tid()
    if moves.spare[i] != 0:
        moves.spare_list[moves.spare_first[i]] = i


@wp.kernel(**KERNEL_OPTIONS)
def put_overflow_kernel(blocks: Blocks, rays: DeviceRayList, moves: Moves):
    """By sorted ray: those without an entry in a block go to the overflow."""
    i = wp.tid()
    if moves.flags[i] != 0:
        spare = moves.spare_list[moves.flags_first[i]]
        index = moves.order[i]
        pool_index = blocks.overflow_at + spare
        blocks.overflow_queue[spare] = moves.keys[i]
        blocks.slots[pool_index] = rays.slots[index]
        if rays.pool_index.shape[0] > 0:
            rays.pool_index[index] = pool_index


@wp.kernel(**KERNEL_OPTIONS)
def put_close_kernel(blocks: Blocks, moves: Moves):
    """By queue: the rays are its own now."""
    queue = wp.tid()
    added = moves.run_end[queue] - moves.run_first[queue]
    if added == 0:
        return
    size = blocks.queue_size
    filled = blocks.in_blocks[queue]
    had = blocks_for(filled, size)
    free = blocks.state[FREE]
    first = moves.amount_first[queue]
    got = wp.clamp(free - first, 0, moves.amount[queue])
    if got > 0:
        blocks.open[queue] = blocks.free[free - first - got]
    blocks.in_blocks[queue] = wp.min(filled + added, (had + got) * size)
    if blocks.counts[queue] == 0:
        blocks.since[queue] = blocks.state[STEP]
    blocks.counts[queue] = blocks.counts[queue] + added
    moves.run_first[queue] = 0
    moves.run_end[queue] = 0


@wp.kernel(**KERNEL_OPTIONS)
def put_state_kernel(blocks: Blocks, moves: Moves, bound: int):
    """One thread: the totals."""
    free = blocks.state[FREE]
    wanted = moves.amount_first[blocks.counts.shape[0]]
    free = wp.max(free - wanted, 0)
    blocks.state[FREE] = free
    blocks.state[IN_USE_PEAK] = wp.max(blocks.state[IN_USE_PEAK], blocks.owner.shape[0] - free)
    blocks.put[0] = blocks.put[0] + wp.int64(moves.total[0])
    blocks.state[WAITING] = blocks.state[WAITING] + moves.total[0]
    if moves.flags.shape[0] > 0:
        over = moves.flags_first[bound]
        if over > 0:
            blocks.state[OVERFLOW] = blocks.state[OVERFLOW] + over
            blocks.state[SHORT] = blocks.state[SHORT] + 1


PUT_KERNELS = (
    put_key_kernel,
    put_run_kernel,
    put_grow_kernel,
    put_place_kernel,
    spare_kernel,
    spare_list_kernel,
    put_overflow_kernel,
    put_close_kernel,
    put_state_kernel,
)
