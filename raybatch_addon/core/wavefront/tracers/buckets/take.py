"""Rays are taken out of queues by many threads: whole queues, side by side in the batch."""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....rays import DeviceRayList
from .blocks import FREE, OVERFLOW, STEP, WAIT_MAX, WAITING, Blocks, Moves, QueueRule, blocks_for, location_of


@wp.kernel(**KERNEL_OPTIONS)
def mask_range_kernel(moves: Moves, first: int, step: int):
    """Choose every `step`-th queue from `first` on."""
    moves.mask[first + step * wp.tid()] = 1


@wp.kernel(**KERNEL_OPTIONS)
def mask_list_kernel(moves: Moves, chosen: wp.array(dtype=int)):
    """Choose queues."""
    moves.mask[chosen[wp.tid()]] = 1


@wp.kernel(**KERNEL_OPTIONS)
def take_amount_kernel(blocks: Blocks, moves: Moves):
    """By queue: rays that would be taken."""
    queue = wp.tid()
    moves.amount[queue] = wp.where(moves.mask[queue] != 0, blocks.in_blocks[queue], 0)


@wp.kernel(**KERNEL_OPTIONS)
def take_part_kernel(blocks: Blocks, rays: DeviceRayList, moves: Moves):
    """By queue: whole blocks that the batch has room for."""
    queue = wp.tid()
    size = blocks.queue_size
    amount, first = moves.amount[queue], moves.amount_first[queue]
    fits = first + amount <= rays.capacity
    part = int(0)
    if fits:
        part = blocks_for(amount, size)
    elif first < rays.capacity:
        part = (rays.capacity - first) // size
    moves.part[queue] = part
    # one queue knows how many rays there are: the first that does not fit, else the last
    if fits:
        if queue == blocks.counts.shape[0] - 1:
            rays.count[0] = first + amount
    elif first <= rays.capacity:
        rays.count[0] = first + part * size


@wp.kernel(**KERNEL_OPTIONS)
def take_list_kernel(blocks: Blocks, moves: Moves):
    """By block: those that are taken are listed, and lie on the stack of free blocks."""
    block = wp.tid()
    queue = blocks.owner[block]
    if queue < 0:
        return
    if moves.mask[queue] != 0 and blocks.link[block] < moves.part[queue]:
        index = moves.part_first[queue] + blocks.link[block]
        moves.listed[index] = block
        blocks.free[blocks.state[FREE] + index] = block


@wp.kernel(**KERNEL_OPTIONS)
def take_copy_kernel(blocks: Blocks, rule: QueueRule, rays: DeviceRayList, moves: Moves):
    """By entry of the blocks that are taken."""
    i = wp.tid()
    size = blocks.queue_size
    index, offset = i // size, i % size
    if index >= moves.part_first[blocks.counts.shape[0]]:
        return
    block = moves.listed[index]
    queue = blocks.owner[block]
    position = blocks.link[block] * size + offset
    if position < blocks.in_blocks[queue]:
        at = moves.amount_first[queue] + position
        rays.slots[at] = blocks.slots[block * size + offset]
        rays.locations[at] = location_of(rule, queue)
        if rays.pool_index.shape[0] > 0:
            rays.pool_index[at] = block * size + offset


@wp.kernel(**KERNEL_OPTIONS)
def take_flag_kernel(blocks: Blocks, moves: Moves):
    """By entry of the overflow: whether its ray belongs to a queue that was chosen."""
    i = wp.tid()
    queue = blocks.overflow_queue[i]
    flag = int(0)
    if queue >= 0:
        flag = moves.mask[queue]
    moves.spare[i] = flag


@wp.kernel(**KERNEL_OPTIONS)
def take_overflow_kernel(blocks: Blocks, rule: QueueRule, rays: DeviceRayList, moves: Moves):
    """By entry of the overflow: rays that were chosen go behind the others, as long as there is room."""
    i = wp.tid()
    at = rays.count[0] + moves.spare_first[i]
    if moves.spare[i] != 0 and at < rays.capacity:
        queue = blocks.overflow_queue[i]
        rays.slots[at] = blocks.slots[blocks.overflow_at + i]
        rays.locations[at] = location_of(rule, queue)
        if rays.pool_index.shape[0] > 0:
            rays.pool_index[at] = blocks.overflow_at + i
        blocks.overflow_queue[i] = -1
        wp.atomic_sub(blocks.counts, queue, 1)
        wp.atomic_max(blocks.state, WAIT_MAX, blocks.state[STEP] - blocks.since[queue])


@wp.kernel(**KERNEL_OPTIONS)
def take_close_kernel(blocks: Blocks, moves: Moves):
    """By queue and by block: what was taken is the queues' no more."""
    i = wp.tid()
    if i < blocks.owner.shape[0]:
        queue = blocks.owner[i]
        if queue >= 0:
            if moves.mask[queue] != 0:
                number = blocks.link[i] - moves.part[queue]
                blocks.link[i] = number
                if number < 0:
                    blocks.owner[i] = -1


@wp.kernel(**KERNEL_OPTIONS)
def take_queue_kernel(blocks: Blocks, moves: Moves):
    """By queue: its counts, and the choice is forgotten."""
    queue = wp.tid()
    if moves.mask[queue] == 0:
        return
    moves.mask[queue] = 0
    amount = wp.min(moves.amount[queue], moves.part[queue] * blocks.queue_size)
    if amount > 0:
        wp.atomic_max(blocks.state, WAIT_MAX, blocks.state[STEP] - blocks.since[queue])
        blocks.counts[queue] = blocks.counts[queue] - amount
        left = moves.amount[queue] - amount
        blocks.in_blocks[queue] = left
        if left == 0:
            blocks.open[queue] = -1


@wp.kernel(**KERNEL_OPTIONS)
def take_state_kernel(blocks: Blocks, rays: DeviceRayList, moves: Moves):
    """One thread: the totals."""
    blocks.state[FREE] = blocks.state[FREE] + moves.part_first[blocks.counts.shape[0]]
    if moves.spare.shape[0] > 0:
        over = wp.min(moves.spare_first[moves.spare.shape[0]], rays.capacity - rays.count[0])
        rays.count[0] = rays.count[0] + over
        blocks.state[OVERFLOW] = blocks.state[OVERFLOW] - over
    blocks.state[WAITING] = blocks.state[WAITING] - rays.count[0]


TAKE_KERNELS = (
    mask_range_kernel,
    mask_list_kernel,
    take_amount_kernel,
    take_part_kernel,
    take_list_kernel,
    take_copy_kernel,
    take_flag_kernel,
    take_overflow_kernel,
    take_close_kernel,
    take_queue_kernel,
    take_state_kernel,
)
