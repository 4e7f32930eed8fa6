"""Queues of one CPU thread: rays are appended one after another, and blocks of a queue are chained."""

from __future__ import annotations

import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....rays import DeviceRayList
from .blocks import (
    FREE,
    IN_USE_PEAK,
    OVERFLOW,
    SHORT,
    STEP,
    WAIT_MAX,
    WAITING,
    Blocks,
    QueueRule,
    location_of,
    queue_of,
)


@wp.func
def put_rays(blocks: Blocks, rule: QueueRule, rays: DeviceRayList):
    """Append the first `count[0]` rays to their queues."""
    size = blocks.queue_size
    queue_total = blocks.counts.shape[0]
    free = int(blocks.state[FREE])
    put = int(0)
    over = int(0)
    step = blocks.state[STEP]
    wants_index = rays.pool_index.shape[0] > 0
    for i in range(rays.count[0]):
        queue = queue_of(rule, rays.locations[i])
        pool_index = int(-1)
        if queue >= 0:
            filled = blocks.in_blocks[queue]
            last = int(blocks.open[queue])
            offset = filled % size
            if offset != 0:
                pool_index = last * size + offset
            elif free > 0:
                free -= 1
                block = blocks.free[free]
                blocks.owner[block] = queue
                if last < 0:
                    blocks.first[queue] = block
                else:
                    blocks.link[last] = block
                blocks.open[queue] = block
                pool_index = block * size
            if pool_index >= 0:
                blocks.in_blocks[queue] = filled + 1
            else:
                spare = blocks.overflow_first[queue_total]
                blocks.overflow_first[queue_total] = blocks.overflow_link[spare]
                blocks.overflow_link[spare] = blocks.overflow_first[queue]
                blocks.overflow_first[queue] = spare
                blocks.overflow_queue[spare] = queue
                pool_index = blocks.overflow_at + spare
                over += 1
            count = blocks.counts[queue]
            if count == 0:
                blocks.since[queue] = step
            blocks.counts[queue] = count + 1
            blocks.slots[pool_index] = rays.slots[i]
            put += 1
        if wants_index:
            rays.pool_index[i] = pool_index
    blocks.state[FREE] = free
    blocks.state[IN_USE_PEAK] = wp.max(blocks.state[IN_USE_PEAK], blocks.owner.shape[0] - free)
    blocks.put[0] = blocks.put[0] + wp.int64(put)
    blocks.state[WAITING] = blocks.state[WAITING] + put
    if over > 0:
        blocks.state[OVERFLOW] = blocks.state[OVERFLOW] + over
        blocks.state[SHORT] = blocks.state[SHORT] + 1


@wp.func
def take_queue(blocks: Blocks, rule: QueueRule, rays: DeviceRayList, queue: int, taken: int) -> int:
    """Append rays of `queue` to the list, which has `taken`, whole blocks as long as there is room; how many it has
    then.
    """
    if blocks.counts[queue] == 0:
        return taken
    size = blocks.queue_size
    queue_total = blocks.counts.shape[0]
    location = location_of(rule, queue)
    wants_index = rays.pool_index.shape[0] > 0
    free = int(blocks.state[FREE])
    at = int(taken)
    left = int(blocks.in_blocks[queue])
    block = int(blocks.first[queue])
    room = bool(True)
    while left > 0 and room:
        here = wp.min(left, size)
        room = at + here <= rays.capacity
        if room:
            for i in range(here):
                rays.slots[at + i] = blocks.slots[block * size + i]
                rays.locations[at + i] = location
            if wants_index:
                for i in range(here):
                    rays.pool_index[at + i] = block * size + i
            at += here
            left -= here
            blocks.owner[block] = -1
            blocks.free[free] = block
            free += 1
            block = blocks.link[block]
    blocks.in_blocks[queue] = left
    blocks.first[queue] = wp.where(left > 0, block, -1)
    if left == 0:
        blocks.open[queue] = -1
    spare = int(blocks.overflow_first[queue])
    over = int(0)
    while spare >= 0 and at < rays.capacity:
        rays.slots[at] = blocks.slots[blocks.overflow_at + spare]
        rays.locations[at] = location
        if wants_index:
            rays.pool_index[at] = blocks.overflow_at + spare
        at += 1
        over += 1
        follower = blocks.overflow_link[spare]
        blocks.overflow_queue[spare] = -1
        blocks.overflow_link[spare] = blocks.overflow_first[queue_total]
        blocks.overflow_first[queue_total] = spare
        spare = follower
    blocks.overflow_first[queue] = spare
    blocks.state[OVERFLOW] = blocks.state[OVERFLOW] - over
    blocks.state[FREE] = free
    blocks.counts[queue] = blocks.counts[queue] - (at - taken)
    blocks.state[WAITING] = blocks.state[WAITING] - (at - taken)
    if at > taken:
        blocks.state[WAIT_MAX] = wp.max(blocks.state[WAIT_MAX], blocks.state[STEP] - blocks.since[queue])
    return at


@wp.kernel(**KERNEL_OPTIONS)
def host_put_kernel(blocks: Blocks, rule: QueueRule, rays: DeviceRayList):
    """Launched once."""
    put_rays(blocks, rule, rays)


@wp.kernel(**KERNEL_OPTIONS)
def host_take_kernel(
    blocks: Blocks, rule: QueueRule, rays: DeviceRayList, chosen: wp.array(dtype=int), chosen_count: int
):
    """Launched once; `chosen_count` -1: all queues."""
    taken = int(0)
    if chosen_count < 0:
        for queue in range(blocks.counts.shape[0]):
            taken = take_queue(blocks, rule, rays, queue, taken)
    else:
        for i in range(chosen_count):
            taken = take_queue(blocks, rule, rays, chosen[i], taken)
    rays.count[0] = taken
