"""The loop of the simulation, and what it is given and says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from studies.hardware.caches import Lines, Memory, add, find, read_line, read_there, request
from studies.hardware.engine import (
    CYCLES,
    FINISHED,
    ITEMS,
    POLL,
    QUEUE_WRITTEN,
    QUEUED,
    ROW_FREE,
    State,
    Work,
    enqueue,
    fetch_rows,
    move_to,
    pop,
    prefetch,
    push,
    queue_traffic,
    sector_mask,
    take,
    treelet_of,
    wait_in_row,
    word_of,
)
from studies.hardware.machine import ACCUMULATE, COUNTERS, QUEUES, TICKS, Cache, Counts, Plan
from studies.hardware.traces import NODE_WORDS, TRIANGLE_WORDS, WORD_BYTES

LAST_TICK = TICKS - 1  # of a cycle
RETRY = 16 * TICKS  # after so long a slot that finds no row free looks again [ticks]


@wp.func
def end_of(w: Work, m: Memory, item: int) -> int:
    """The last sector of an item."""
    words = int(TRIANGLE_WORDS)
    if item >= 0:
        words = NODE_WORDS
    return (word_of(w, item) + words - 1) / m.sector_words


@wp.func
def read_item(w: Work, m: Memory, p: int, item: int, now: wp.int64) -> wp.int64:
    """When all of an item is at processor `p`, which asks for it now."""
    first = word_of(w, item) / m.sector_words
    last = end_of(w, m, item)
    done = now
    for line in range(first / m.line_sectors, last / m.line_sectors + 1):
        done = wp.max(done, read_line(m, p, line, sector_mask(m, line, first, last), now))
    return done


@wp.func
def read_or_wait(w: Work, s: State, m: Memory, slot: int, item: int, now: wp.int64) -> wp.int64:
    """The same, of lines that are there; at the first that is not the ray waits, and -1 is returned."""
    p = slot / w.slots
    first = word_of(w, item) / m.sector_words
    last = end_of(w, m, item)
    done = now
    bit = int(1)
    for line in range(first / m.line_sectors, last / m.line_sectors + 1):
        if done >= wp.int64(0) and (s.served[slot] & bit) == 0:
            mask = sector_mask(m, line, first, last)
            where = find(m.l1, p, line)
            missing = int(mask)
            if where >= 0:
                missing = mask & ~m.l1.mask[where]
            if missing == 0:
                done = wp.max(done, read_there(m, p, where, mask, request(m, p, now)))
                s.served[slot] = s.served[slot] | bit
            elif wait_in_row(w, s, m, slot, line, missing, now) != 0:
                s.served[slot] = s.served[slot] | bit
                fetch_rows(w, s, m, p, request(m, p, now))
                done = wp.int64(-1)
            else:
                push(s, slot, now + wp.int64(RETRY))
                done = wp.int64(-1)
        bit = bit * 2
    return done


@wp.func
def leave(w: Work, s: State, m: Memory, slot: int, now: wp.int64) -> int:
    """A ray that is at its end, or of QUEUES at another treelet, leaves its slot; returns whether one did."""
    left = int(0)
    ray = s.ray[slot]
    if ray >= 0:
        if s.at[slot] == w.first[ray + 1]:
            s.size[2] = s.size[2] + 1
            add(m, FINISHED, 1)
            left = 1
        elif w.mode == QUEUES:
            if treelet_of(w, w.items[s.at[slot]]) != s.where[slot]:
                enqueue(w, s, ray, s.at[slot])
                queue_traffic(w, m, QUEUE_WRITTEN, now)
                add(m, QUEUED, 1)
                left = 1
    if left != 0:
        s.ray[slot] = -1
    return left


@wp.kernel(**KERNEL_OPTIONS)
def simulate_kernel(w: Work, s: State, m: Memory):
    for slot in range(w.processors * w.slots):
        push(s, slot, wp.int64(0))
    now = wp.int64(0)
    last = wp.int64(0)
    while s.size[0] > 0:
        key = pop(s)
        now = key / wp.int64(65536)
        slot = int(key % wp.int64(65536))
        p = slot / w.slots
        if w.mode == ACCUMULATE:
            row = s.leads[slot]
            if row >= 0:
                s.row[row, 0] = ROW_FREE
                s.coming[p] = s.coming[p] - 1
                s.leads[slot] = -1
                fetch_rows(w, s, m, p, now)
        if leave(w, s, m, slot, now) != 0:
            last = now
        then = now
        if s.ray[slot] < 0:
            then = take(w, s, m, slot, now)
            if w.mode == QUEUES and s.ray[slot] >= 0:
                s.where[slot] = treelet_of(w, w.items[s.at[slot]])
        ray = s.ray[slot]
        if ray < 0:
            if w.vote > 0:
                move_to(w, s, slot, -1)
            if w.mode == QUEUES and s.size[2] < w.ray_count:
                push(s, slot, now + wp.int64(POLL))
        elif then > now or s.at[slot] == w.first[ray + 1]:
            push(s, slot, then)
        else:
            item = w.items[s.at[slot]]
            if w.vote > 0:
                move_to(w, s, slot, treelet_of(w, item))
                if now >= s.voted[p]:
                    s.voted[p] = now + wp.int64(w.vote)
                    prefetch(w, s, m, p, now)
            if w.mode == ACCUMULATE:
                then = read_or_wait(w, s, m, slot, item, now)
            else:
                then = read_item(w, m, p, item, now)
            if then >= wp.int64(0):
                s.served[slot] = 0
                s.at[slot] = s.at[slot] + wp.int64(1)
                add(m, ITEMS, 1)
                push(s, slot, then + wp.int64(w.compute))
    m.counts[CYCLES] = (last + wp.int64(LAST_TICK)) / wp.int64(TICKS)


def _array(values: np.ndarray, dtype: type = int) -> wp.array:
    return wp.array(values, dtype=dtype, device="cpu")


def _full(count: int, value: int, dtype: type = int) -> wp.array:
    return wp.full(int(count), value, dtype=dtype, device="cpu")


def _lines(cache: Cache, line: int, banks: int) -> Lines:
    lines = Lines()
    lines.sets, lines.ways = cache.sets(line), cache.ways
    count = max(1, lines.sets * lines.ways * banks)
    lines.tag = _full(count, -1)
    for name in ("mask", "unused", "stamp"):
        setattr(lines, name, _full(count, 0))
    lines.ready, lines.clock = _full(count, 0, wp.int64), _full(1, 0)
    return lines


def _memory(plan: Plan) -> Memory:
    machine, memory = plan.machine, Memory()
    memory.l1 = _lines(machine.l1, machine.line, machine.processors)
    memory.l2 = _lines(machine.l2, machine.line, 1)
    memory.l1_free, memory.free = _full(machine.processors, 0, wp.int64), _full(2, 0, wp.int64)
    memory.counts = _full(len(COUNTERS), 0, wp.int64)
    memory.line_sectors, memory.sector_words = machine.line // machine.sector, machine.sector // WORD_BYTES
    for name in ("l1_latency", "l2_latency", "memory_latency"):
        setattr(memory, name, getattr(machine, name) * TICKS)
    memory.l2_ticks = machine.sector_ticks(machine.l2_rate)
    memory.memory_ticks = machine.sector_ticks(machine.memory_rate)
    return memory


def _work(plan: Plan) -> Work:
    machine, work = plan.machine, Work()
    work.items, work.first = _array(plan.traces.items), _array(plan.traces.first, wp.int64)
    work.node, work.triangle = _array(plan.addresses.node), _array(plan.addresses.triangle)
    if plan.treelets is not None:
        work.node_treelet, work.triangle_treelet = _array(plan.treelets.of_node), _array(plan.treelets.of_triangle)
        work.treelet_count = plan.treelets.count
        if plan.vote_cycles:
            parts = plan.treelets.lines(plan.addresses, machine.line, machine.sector)
            work.line_first, work.lines, work.masks = map(_array, parts)
    work.ray_count, work.compute, work.mode = plan.traces.ray_count, machine.compute * TICKS, plan.mode
    work.processors, work.slots, work.chunk = machine.processors, machine.slots, machine.chunk
    work.rows, work.registers, work.selection = plan.rows, plan.registers, plan.selection
    work.alive, work.ray_bytes, work.in_memory = plan.alive, plan.ray_bytes, int(plan.in_memory)
    work.vote, work.threshold = plan.vote_cycles * TICKS, round(1000 * plan.threshold)
    return work


def _state(plan: Plan, work: Work) -> State:
    processors, slots, state = plan.machine.processors, plan.machine.processors * plan.machine.slots, State()
    state.heap, state.size = _full(slots + 1, 0, wp.int64), _full(5, 0)
    for name in ("ray", "leads", "after", "where"):
        setattr(state, name, _full(slots, -1))
    state.at, state.served = _full(slots, 0, wp.int64), _full(slots, 0)
    state.next, state.coming = _full(2 * processors, 0), _full(processors, 0)
    state.row = wp.zeros((processors * plan.rows if plan.mode == ACCUMULATE else 1, 6), dtype=int, device="cpu")
    state.bound = _full(processors, -1)
    for name in ("servers", "count", "head", "tail"):
        setattr(state, name, _full(work.treelet_count, 0))
    state.winner = _full(2 << int(work.treelet_count).bit_length(), -1)
    waiting = work.ray_count if plan.mode == QUEUES else 0
    state.behind, state.stopped = _full(waiting, -1), _full(waiting, 0, wp.int64)
    state.votes = _full(processors * work.treelet_count if work.vote else 0, 0)
    state.voted, state.fetched = _full(processors, 0, wp.int64), _full(processors, -1)
    return state


def simulate(plan: Plan) -> Counts:
    """What comes of `plan`."""
    work, memory = _work(plan), _memory(plan)
    wp.launch(simulate_kernel, 1, [work, _state(plan, work), memory], device="cpu")
    counts = Counts(**dict(zip(COUNTERS[:-1], memory.counts.numpy().tolist(), strict=False)))
    return finished(plan, counts)


def finished(plan: Plan, counts: Counts) -> Counts:
    """With what a policy takes before rays begin."""
    moved = plan.sorted_bytes * plan.rays
    return replace(
        counts, rays=plan.rays, queue_written=counts.queue_written + moved, queue_read=counts.queue_read + moved
    )
