"""Caches with sectors, in Warp: `twin.py` says the same in plain Python.

All arrays of first-level caches lie one processor behind another.
"""

from __future__ import annotations

import warp as wp

from studies.hardware.machine import TICKS

L1_REQUESTS, L1_HITS, L1_MERGED, L2_REQUESTS, L2_HITS, L2_BYTES, MEMORY_BYTES = 0, 1, 2, 3, 4, 5, 6
PREFETCHED, PREFETCHED_USED = 7, 8


@wp.struct
class Lines:
    """The lines of a cache, set after set."""

    tag: wp.array(dtype=int)  # the line's number, -1: none
    mask: wp.array(dtype=int)  # its sectors that are there or on their way
    unused: wp.array(dtype=int)  # those of them that were prefetched and not read yet
    stamp: wp.array(dtype=int)  # when it was used last, 0: never
    ready: wp.array(dtype=wp.int64)  # when the last of them comes [ticks]
    clock: wp.array(dtype=int)  # uses so far, shape [1]
    sets: int  # 0: there is no cache
    ways: int


@wp.struct
class Memory:
    """Caches and memory."""

    l1: Lines
    l2: Lines
    l1_free: wp.array(dtype=wp.int64)  # by processor, when its cache takes the next request [ticks]
    free: wp.array(dtype=wp.int64)  # likewise the second level and memory, shape [2]
    counts: wp.array(dtype=wp.int64)  # in the order of `Counts`
    line_sectors: int
    sector_words: int
    l1_latency: int  # this and the following in ticks
    l2_latency: int
    memory_latency: int
    l2_ticks: int  # a sector
    memory_ticks: int


@wp.func
def bits(mask: int) -> int:
    """How many are set."""
    count = int(0)
    left = int(mask)
    while left != 0:
        left = left & (left - 1)
        count += 1
    return count


@wp.func
def find(lines: Lines, bank: int, line: int) -> int:
    """Where `line` is in the cache `bank`; -1: nowhere."""
    found = int(-1)
    if lines.sets > 0:
        first = (bank * lines.sets + line % lines.sets) * lines.ways
        for way in range(lines.ways):
            if lines.tag[first + way] == line:
                found = first + way
    return found


@wp.func
def use(lines: Lines, where: int):
    """The line was used now."""
    lines.clock[0] = lines.clock[0] + 1
    lines.stamp[where] = lines.clock[0]


@wp.func
def make_room(lines: Lines, bank: int, line: int) -> int:
    """Where `line`, none of whose sectors is there, is from now on; -1: there is no cache."""
    found = int(-1)
    if lines.sets > 0:
        found = (bank * lines.sets + line % lines.sets) * lines.ways
        for way in range(1, lines.ways):
            other = (bank * lines.sets + line % lines.sets) * lines.ways + way
            if lines.stamp[other] < lines.stamp[found]:
                found = other
        lines.tag[found] = line
        lines.mask[found] = 0
        lines.unused[found] = 0
        lines.ready[found] = wp.int64(0)
    return found


@wp.func
def add(memory: Memory, which: int, count: int):
    """Count."""
    memory.counts[which] = memory.counts[which] + wp.int64(count)


@wp.func
def from_l2(memory: Memory, line: int, mask: int, now: wp.int64) -> wp.int64:
    """When the sectors `mask` of `line`, asked for now, are at the first level."""
    sectors = bits(mask)
    sector_bytes = memory.sector_words * 16
    start = wp.max(now, memory.free[0])
    memory.free[0] = start + wp.int64(sectors * memory.l2_ticks)
    arrival = start + wp.int64(memory.l2_latency)
    add(memory, L2_REQUESTS, 1)
    add(memory, L2_BYTES, sectors * sector_bytes)
    where = find(memory.l2, 0, line)
    missing = int(mask)
    if where >= 0:
        missing = mask & ~memory.l2.mask[where]
    if missing == 0:
        add(memory, L2_HITS, 1)
        arrival = wp.max(arrival, memory.l2.ready[where])
    else:
        start = wp.max(arrival, memory.free[1])
        memory.free[1] = start + wp.int64(bits(missing) * memory.memory_ticks)
        arrival = start + wp.int64(memory.memory_latency)
        add(memory, MEMORY_BYTES, bits(missing) * sector_bytes)
        if where < 0:
            where = make_room(memory.l2, 0, line)
        if where >= 0:
            memory.l2.mask[where] = memory.l2.mask[where] | missing
            arrival = wp.max(memory.l2.ready[where], arrival)
            memory.l2.ready[where] = arrival
    if where >= 0:
        use(memory.l2, where)
    return arrival


@wp.func
def bring(memory: Memory, bank: int, line: int, mask: int, now: wp.int64, prefetched: int) -> wp.int64:
    """When `line` is in the first level with the sectors `mask`, none of which is there."""
    arrival = from_l2(memory, line, mask, now)
    where = find(memory.l1, bank, line)
    if where < 0:
        where = make_room(memory.l1, bank, line)
    if where >= 0:
        memory.l1.mask[where] = memory.l1.mask[where] | mask
        arrival = wp.max(memory.l1.ready[where], arrival)
        memory.l1.ready[where] = arrival
        if prefetched != 0:
            memory.l1.unused[where] = memory.l1.unused[where] | mask
        use(memory.l1, where)
    return arrival


@wp.func
def request(memory: Memory, bank: int, now: wp.int64) -> wp.int64:
    """When the cache of a processor takes a request."""
    start = wp.max(now, memory.l1_free[bank])
    memory.l1_free[bank] = start + wp.int64(TICKS)
    add(memory, L1_REQUESTS, 1)
    return start + wp.int64(memory.l1_latency)


@wp.func
def read_there(memory: Memory, bank: int, where: int, mask: int, then: wp.int64) -> wp.int64:
    """When what is in the first level is read, by a request that was taken and answered `then`."""
    add(memory, L1_HITS, 1)
    if memory.l1.ready[where] > then:
        add(memory, L1_MERGED, 1)
    used = memory.l1.unused[where] & mask
    if used != 0:
        add(memory, PREFETCHED_USED, bits(used) * memory.sector_words * 16)
        memory.l1.unused[where] = memory.l1.unused[where] & ~used
    use(memory.l1, where)
    return wp.max(then, memory.l1.ready[where])


@wp.func
def read_line(memory: Memory, bank: int, line: int, mask: int, now: wp.int64) -> wp.int64:
    """When the sectors `mask` of `line` are at the processor `bank`, which reads them now."""
    then = request(memory, bank, now)
    where = find(memory.l1, bank, line)
    missing = int(mask)
    if where >= 0:
        missing = mask & ~memory.l1.mask[where]
    if missing == 0:
        then = read_there(memory, bank, where, mask, then)
    else:
        if where >= 0:
            used = memory.l1.unused[where] & mask
            if used != 0:
                add(memory, PREFETCHED_USED, bits(used) * memory.sector_words * 16)
                memory.l1.unused[where] = memory.l1.unused[where] & ~used
        then = bring(memory, bank, line, missing, then, 0)
    return then
