"""Parts of the simulation, in Warp: events in the order of their times, each of one ray in flight.

A place for a ray in flight is a *slot*; slot s belongs to processor s // slots. An event is (time << 16 | slot), so
that equal times come in the order of slots. The loop is in `simulate.py`; `twin.py` says the same in plain Python.

Modes: SINGLE rays go through their items as they are. ACCUMULATE: rays that miss a line wait in a row for it, and rows
are fetched when a register is free, those of most rays first. QUEUES: a ray that comes to another treelet waits in its
queue, and processors serve queues.
"""

from __future__ import annotations

import warp as wp

from studies.hardware.caches import PREFETCHED, Memory, add, bits, bring, find
from studies.hardware.machine import BALANCED, LAZY, QUEUES, TICKS

QUEUE_WRITTEN, QUEUE_READ, QUEUE_VISITS, QUEUED, ITEMS, FINISHED, CYCLES = 9, 10, 11, 12, 13, 14, 15
POLL = 64 * TICKS  # after so long a slot without work looks again [ticks]
ROW_FREE, ROW_WAITS, ROW_COMES = 0, 1, 2


@wp.struct
class Work:
    """What is read, and by which policy."""

    items: wp.array(dtype=int)
    first: wp.array(dtype=wp.int64)  # by ray, and the end
    node: wp.array(dtype=int)  # first word of each node
    triangle: wp.array(dtype=int)
    node_treelet: wp.array(dtype=int)  # no entries where treelets do not matter
    triangle_treelet: wp.array(dtype=int)
    line_first: wp.array(dtype=int)  # by treelet, and the end: its lines in the next two, for prefetching
    lines: wp.array(dtype=int)
    masks: wp.array(dtype=int)
    ray_count: int
    treelet_count: int
    processors: int
    slots: int
    chunk: int
    compute: int  # [ticks]
    mode: int
    # ACCUMULATE
    rows: int  # at each processor
    registers: int  # rows that are on their way at most
    # QUEUES
    selection: int  # LAZY or BALANCED
    alive: int  # rays that are in flight or wait, at most
    ray_bytes: int  # written to a queue and read from it
    in_memory: int  # whether queues lie there, or else on the chip
    # prefetching
    vote: int  # ticks between votes, 0: none
    threshold: int  # of the rays in flight that must be in a treelet, in thousandths


@wp.struct
class State:
    """Of slots, processors, rows and queues."""

    heap: wp.array(dtype=wp.int64)
    size: wp.array(dtype=int)  # of the heap; then rays begun, finished, in queues; queues with rays; shape [5]
    ray: wp.array(dtype=int)  # by slot, -1: none
    at: wp.array(dtype=wp.int64)  # by slot, its next item
    served: wp.array(dtype=int)  # by slot, ACCUMULATE: lines of the next item that it was given, as bits
    leads: wp.array(dtype=int)  # by slot, ACCUMULATE: the row whose coming it tells of, -1: none
    after: wp.array(dtype=int)  # by slot, ACCUMULATE: the next one that waits in the row
    where: wp.array(dtype=int)  # by slot, with treelets: the one that it is in, -1: none
    next: wp.array(dtype=int)  # by processor, the next ray of its chunk, then the end, shape [2 * processors]
    row: wp.array2d(dtype=int)  # by row: state, line, mask, count, first slot, last slot, place of the line
    coming: wp.array(dtype=int)  # by processor, rows on their way
    bound: wp.array(dtype=int)  # by processor, the treelet that it serves, -1: none
    servers: wp.array(dtype=int)  # by treelet, processors that serve it
    winner: wp.array(dtype=int)  # of all queues in the last half, above it of pairs: which is served before; [1] of all
    count: wp.array(dtype=int)  # by treelet, rays that wait
    head: wp.array(dtype=int)
    tail: wp.array(dtype=int)
    behind: wp.array(dtype=int)  # by ray, the one behind it in its queue
    stopped: wp.array(dtype=wp.int64)  # by ray, its next item
    votes: wp.array(dtype=int)  # by processor and treelet, rays in flight there
    voted: wp.array(dtype=wp.int64)  # by processor, when the next vote is
    fetched: wp.array(dtype=int)  # by processor, the treelet that was prefetched last


@wp.func
def push(s: State, slot: int, now: wp.int64):
    """An event of `slot`."""
    key = now * wp.int64(65536) + wp.int64(slot)
    i = int(s.size[0])
    s.size[0] = i + 1
    while i > 0 and s.heap[(i - 1) / 2] > key:
        s.heap[i] = s.heap[(i - 1) / 2]
        i = (i - 1) / 2
    s.heap[i] = key


@wp.func
def pop(s: State) -> wp.int64:
    """The next event."""
    top = s.heap[0]
    n = s.size[0] - 1
    s.size[0] = n
    key = s.heap[n]
    i = int(0)
    child = int(1)
    while child < n:
        if child + 1 < n and s.heap[child + 1] < s.heap[child]:
            child += 1
        if s.heap[child] < key:
            s.heap[i] = s.heap[child]
            i = child
            child = 2 * i + 1
        else:
            child = n
    s.heap[i] = key
    return top


@wp.func
def treelet_of(w: Work, item: int) -> int:
    """The treelet of an item."""
    found = int(0)
    if item >= 0:
        found = w.node_treelet[item]
    else:
        found = w.triangle_treelet[~item]
    return found


@wp.func
def word_of(w: Work, item: int) -> int:
    """The first word of an item."""
    found = int(0)
    if item >= 0:
        found = w.node[item]
    else:
        found = w.triangle[~item]
    return found


@wp.func
def sector_mask(m: Memory, line: int, first: int, last: int) -> int:
    """The sectors of `line` from sector `first` to `last`, both numbered from the beginning of memory."""
    low = wp.max(first - line * m.line_sectors, 0)
    high = wp.min(last - line * m.line_sectors, m.line_sectors - 1)
    return ((2 << high) - 1) & ~((1 << low) - 1)


@wp.func
def wins(w: Work, s: State, a: int, b: int) -> int:
    """Of two treelets, -1 for none, that whose queue is to be served before, `a` where they are alike: of LAZY one that
    no processor serves, else the fuller; of BALANCED that with more rays for each processor that would serve it.
    """
    won = int(a)
    if a < 0:
        won = b
    elif b >= 0:
        if w.selection == LAZY:
            free_a = wp.where(s.servers[a] == 0, 1, 0)
            free_b = wp.where(s.servers[b] == 0, 1, 0)
            if free_b > free_a or (free_b == free_a and s.count[b] > s.count[a]):
                won = b
        elif wp.int64(s.count[b]) * wp.int64(1 + s.servers[a]) > wp.int64(s.count[a]) * wp.int64(1 + s.servers[b]):
            won = b
    return won


@wp.func
def compete(w: Work, s: State, q: int):
    """The queue of a treelet, or who serves it, has changed."""
    i = s.winner.shape[0] / 2 + q
    s.winner[i] = wp.where(s.count[q] > 0, q, -1)
    i = i / 2
    while i > 0:
        s.winner[i] = wins(w, s, s.winner[2 * i], s.winner[2 * i + 1])
        i = i / 2


@wp.func
def serve(w: Work, s: State, q: int, change: int):
    """So many more processors serve the treelet."""
    s.servers[q] = s.servers[q] + change
    compete(w, s, q)


@wp.func
def enqueue(w: Work, s: State, ray: int, at: wp.int64):
    """A ray waits at the treelet of its next item."""
    q = treelet_of(w, w.items[at])
    s.stopped[ray] = at
    s.behind[ray] = -1
    if s.count[q] == 0:
        s.head[q] = ray
    else:
        s.behind[s.tail[q]] = ray
    s.tail[q] = ray
    s.count[q] = s.count[q] + 1
    if s.count[q] == 1:
        s.size[4] = s.size[4] + 1
    s.size[3] = s.size[3] + 1
    compete(w, s, q)


@wp.func
def begin_queued(w: Work, s: State, m: Memory):
    """New rays wait at the treelet of the root, as many as may be alive."""
    while s.size[1] < w.ray_count and s.size[1] - s.size[2] < w.alive:
        ray = s.size[1]
        s.size[1] = ray + 1
        if w.first[ray] < w.first[ray + 1]:
            enqueue(w, s, ray, w.first[ray])
        else:
            s.size[2] = s.size[2] + 1
            add(m, FINISHED, 1)


@wp.func
def choose(w: Work, s: State, m: Memory, p: int):
    """Processor `p` is given another queue."""
    if s.bound[p] >= 0:
        serve(w, s, s.bound[p], -1)
    s.bound[p] = s.winner[1]
    serve(w, s, s.bound[p], 1)
    add(m, QUEUE_VISITS, 1)


@wp.func
def queue_traffic(w: Work, m: Memory, which: int, now: wp.int64) -> wp.int64:
    """When a ray is written to a queue, or read."""
    add(m, which, w.ray_bytes)
    then = now + wp.int64(m.l1_latency)
    if w.in_memory != 0:
        start = wp.max(now, m.free[1])
        m.free[1] = start + wp.int64(((w.ray_bytes + m.sector_words * 16 - 1) / (m.sector_words * 16)) * m.memory_ticks)
        then = start + wp.int64(m.memory_latency)
    return then


@wp.func
def take(w: Work, s: State, m: Memory, slot: int, now: wp.int64) -> wp.int64:
    """The slot gets a ray, if there is one; returns when it can go on."""
    p = slot / w.slots
    then = now
    s.ray[slot] = -1
    if w.mode == QUEUES:
        begin_queued(w, s, m)
        if s.size[3] > 0:
            if s.bound[p] < 0 or s.count[s.bound[p]] == 0:
                choose(w, s, m, p)
            elif w.selection == BALANCED:
                own = wp.int64(s.count[s.bound[p]]) * wp.int64(s.size[4])
                if own < wp.int64(s.size[3]) and s.servers[s.bound[p]] > 1:
                    choose(w, s, m, p)
            q = s.bound[p]
            ray = s.head[q]
            s.head[q] = s.behind[ray]
            s.count[q] = s.count[q] - 1
            if s.count[q] == 0:
                s.size[4] = s.size[4] - 1
            compete(w, s, q)
            s.size[3] = s.size[3] - 1
            s.ray[slot] = ray
            s.at[slot] = s.stopped[ray]
            if s.stopped[ray] > w.first[ray]:
                then = queue_traffic(w, m, QUEUE_READ, now)
    else:
        if s.next[2 * p] == s.next[2 * p + 1]:
            s.next[2 * p] = s.size[1]
            s.next[2 * p + 1] = wp.min(s.size[1] + w.chunk, w.ray_count)
            s.size[1] = s.next[2 * p + 1]
        if s.next[2 * p] < s.next[2 * p + 1]:
            s.ray[slot] = s.next[2 * p]
            s.at[slot] = w.first[s.next[2 * p]]
            s.next[2 * p] = s.next[2 * p] + 1
    return then


@wp.func
def fetch_rows(w: Work, s: State, m: Memory, p: int, now: wp.int64):
    """Rows of processor `p` are fetched, of most rays first, while registers are free."""
    again = int(1)
    while again != 0 and s.coming[p] < w.registers:
        best = int(-1)
        for r in range(p * w.rows, (p + 1) * w.rows):
            if s.row[r, 0] == ROW_WAITS:
                if best < 0 or s.row[r, 3] > s.row[best, 3]:
                    best = r
        again = 0
        if best >= 0:
            again = 1
            arrival = bring(m, p, s.row[best, 1], s.row[best, 2], now, 0)
            s.row[best, 0] = ROW_COMES
            s.coming[p] = s.coming[p] + 1
            add(m, QUEUE_VISITS, 1)
            slot = int(s.row[best, 4])
            s.leads[slot] = best
            while slot >= 0:
                push(s, slot, arrival)
                slot = s.after[slot]


@wp.func
def wait_in_row(w: Work, s: State, m: Memory, slot: int, line: int, mask: int, now: wp.int64) -> int:
    """The slot waits for sectors of a line that no row has asked for yet; returns 0 where no row is free."""
    p = slot / w.slots
    found = int(-1)
    free = int(-1)
    for r in range(p * w.rows, (p + 1) * w.rows):
        if s.row[r, 0] == ROW_WAITS and s.row[r, 1] == line:
            found = r
        if s.row[r, 0] == ROW_FREE and free < 0:
            free = r
    s.after[slot] = -1
    if found >= 0:
        s.row[found, 2] = s.row[found, 2] | mask
        s.row[found, 3] = s.row[found, 3] + 1
        s.after[s.row[found, 5]] = slot
        s.row[found, 5] = slot
    elif free >= 0:
        found = free
        s.row[free, 0] = ROW_WAITS
        s.row[free, 1] = line
        s.row[free, 2] = mask
        s.row[free, 3] = 1
        s.row[free, 4] = slot
        s.row[free, 5] = slot
    if found >= 0:
        add(m, QUEUED, 1)
    return found + 1


@wp.func
def prefetch(w: Work, s: State, m: Memory, p: int, now: wp.int64):
    """The rays in flight of processor `p` vote for the treelet in which most of them are, and it is prefetched where
    these are enough.
    """
    best = int(-1)
    there = int(0)
    for slot in range(p * w.slots, (p + 1) * w.slots):
        t = s.where[slot]
        if t >= 0:
            there += 1
            if best < 0:
                best = t
            else:
                mine = s.votes[p * w.treelet_count + t]
                most = s.votes[p * w.treelet_count + best]
                if mine > most or (mine == most and t < best):
                    best = t
    if best >= 0 and best != s.fetched[p]:
        if s.votes[p * w.treelet_count + best] * 1000 >= w.threshold * there:
            s.fetched[p] = best
            for i in range(w.line_first[best], w.line_first[best + 1]):
                found = find(m.l1, p, w.lines[i])
                missing = int(w.masks[i])
                if found >= 0:
                    missing = missing & ~m.l1.mask[found]
                if missing != 0:
                    bring(m, p, w.lines[i], missing, now, 1)
                    add(m, PREFETCHED, bits(missing) * m.sector_words * 16)


@wp.func
def move_to(w: Work, s: State, slot: int, treelet: int):
    """The ray in flight is in `treelet`, -1: nowhere."""
    p = slot / w.slots
    old = s.where[slot]
    if old != treelet:
        if old >= 0:
            s.votes[p * w.treelet_count + old] = s.votes[p * w.treelet_count + old] - 1
        if treelet >= 0:
            s.votes[p * w.treelet_count + treelet] = s.votes[p * w.treelet_count + treelet] + 1
        s.where[slot] = treelet
