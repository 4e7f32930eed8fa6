"""Queues of one CPU thread: rays are appended one after another, and blocks of a queue are chained."""

from __future__ import annotations

import warp as wp

from ..kernel import KERNEL_OPTIONS
from .bucket_blocks import FREE, IN_USE_PEAK, OVERFLOW, SHORT, STEP, WAITING, WAIT_MAX, Blocks, Listed, QueueRule, queue_of, where_of

_FREE = wp.constant(FREE)
_OVERFLOW = wp.constant(OVERFLOW)
_PEAK = wp.constant(IN_USE_PEAK)
_SHORT = wp.constant(SHORT)
_WAIT = wp.constant(WAIT_MAX)
_STEP = wp.constant(STEP)
_WAITING = wp.constant(WAITING)


@wp.func
def put_rays(blocks: Blocks, rule: QueueRule, rays: Listed):
    """Append the first `count[0]` rays to their queues."""
    size = blocks.queue_size
    queue_total = blocks.counts.shape[0]
    free = int(blocks.state[_FREE])
    put = int(0)
    over = int(0)
    step = blocks.state[_STEP]
    want_places = rays.places.shape[0] > 0
    for i in range(rays.count[0]):
        queue = queue_of(rule, rays.where[i])
        place = int(-1)
        if queue >= 0:
            filled = blocks.in_blocks[queue]
            last = int(blocks.open[queue])
            offset = filled % size
            if offset != 0:
                place = last * size + offset
            elif free > 0:
                free -= 1
                block = blocks.free[free]
                blocks.owner[block] = queue
                if last < 0:
                    blocks.first[queue] = block
                else:
                    blocks.link[last] = block
                blocks.open[queue] = block
                place = block * size
            if place >= 0:
                blocks.in_blocks[queue] = filled + 1
            else:
                spare = blocks.overflow_first[queue_total]
                blocks.overflow_first[queue_total] = blocks.overflow_link[spare]
                blocks.overflow_link[spare] = blocks.overflow_first[queue]
                blocks.overflow_first[queue] = spare
                blocks.overflow_queue[spare] = queue
                place = blocks.overflow_at + spare
                over += 1
            count = blocks.counts[queue]
            if count == 0:
                blocks.since[queue] = step
            blocks.counts[queue] = count + 1
            blocks.slots[place] = rays.slots[i]
            put += 1
        if want_places:
            rays.places[i] = place
    blocks.state[_FREE] = free
    blocks.state[_PEAK] = wp.max(blocks.state[_PEAK], blocks.owner.shape[0] - free)
    blocks.put[0] = blocks.put[0] + wp.int64(put)
    blocks.state[_WAITING] = blocks.state[_WAITING] + put
    if over > 0:
        blocks.state[_OVERFLOW] = blocks.state[_OVERFLOW] + over
        blocks.state[_SHORT] = blocks.state[_SHORT] + 1


@wp.func
def take_queue(blocks: Blocks, rule: QueueRule, rays: Listed, queue: int, taken: int) -> int:
    """Append rays of `queue` to the list, which has `taken`, whole blocks as long as there is room; how many it has then."""
    if blocks.counts[queue] == 0:
        return taken
    size = blocks.queue_size
    queue_total = blocks.counts.shape[0]
    where = where_of(rule, queue)
    want_places = rays.places.shape[0] > 0
    free = int(blocks.state[_FREE])
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
                rays.where[at + i] = where
            if want_places:
                for i in range(here):
                    rays.places[at + i] = block * size + i
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
        rays.where[at] = where
        if want_places:
            rays.places[at] = blocks.overflow_at + spare
        at += 1
        over += 1
        follower = blocks.overflow_link[spare]
        blocks.overflow_queue[spare] = -1
        blocks.overflow_link[spare] = blocks.overflow_first[queue_total]
        blocks.overflow_first[queue_total] = spare
        spare = follower
    blocks.overflow_first[queue] = spare
    blocks.state[_OVERFLOW] = blocks.state[_OVERFLOW] - over
    blocks.state[_FREE] = free
    blocks.counts[queue] = blocks.counts[queue] - (at - taken)
    blocks.state[_WAITING] = blocks.state[_WAITING] - (at - taken)
    if at > taken:
        blocks.state[_WAIT] = wp.max(blocks.state[_WAIT], blocks.state[_STEP] - blocks.since[queue])
    return at


@wp.kernel(**KERNEL_OPTIONS)
def host_put_kernel(blocks: Blocks, rule: QueueRule, rays: Listed):
    """Launched once."""
    put_rays(blocks, rule, rays)


@wp.kernel(**KERNEL_OPTIONS)
def host_take_kernel(blocks: Blocks, rule: QueueRule, rays: Listed, chosen: wp.array(dtype=int), chosen_count: int):
    """Launched once; `chosen_count` -1: all queues."""
    taken = int(0)
    if chosen_count < 0:
        for queue in range(blocks.counts.shape[0]):
            taken = take_queue(blocks, rule, rays, queue, taken)
    else:
        for i in range(chosen_count):
            taken = take_queue(blocks, rule, rays, chosen[i], taken)
    rays.count[0] = taken
