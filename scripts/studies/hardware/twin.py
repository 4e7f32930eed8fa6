"""The simulation in plain Python, for tests on small inputs: the same machine with other means, and the same counts to
the last.

Caches are dictionaries in the order of use, events a heap of Python's, queues and rows deques and lists of objects.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter, OrderedDict, deque
from dataclasses import dataclass, field

import numpy as np

from studies.hardware.machine import ACCUMULATE, COUNTERS, LAZY, QUEUES, TICKS, Cache, Counts, Plan
from studies.hardware.simulate import POLL, RETRY, finished


@dataclass
class Line:
    """A line that is there, or on its way."""

    sectors: set[int] = field(default_factory=set)
    unused: set[int] = field(default_factory=set)  # of them: prefetched, and not read yet
    ready: int = 0


class LruCache:
    """Sets of lines in the order of their last use."""

    def __init__(self, cache: Cache, line: int):
        self._ways = cache.ways
        self._sets: list[OrderedDict[int, Line]] = [OrderedDict() for _ in range(cache.sets(line))]

    def find(self, line: int) -> Line | None:
        """The line, if it is there."""
        return self._sets[line % len(self._sets)].get(line) if self._sets else None

    def get(self, line: int) -> Line:
        """The line, which is there from now on; where there is no cache it is forgotten."""
        if not self._sets:
            return Line()
        found = self._sets[line % len(self._sets)]
        if line not in found:
            if len(found) == self._ways:
                found.popitem(last=False)
            found[line] = Line()
        found.move_to_end(line)
        return found[line]


@dataclass
class Ray:
    """A ray, or a packet, on its way."""

    number: int
    items: list[int]
    at: int = 0
    treelet: int = -1


@dataclass
class Row:
    """Slots that wait for a line; `comes` once it was fetched."""

    line: int
    sectors: set[int]
    slots: list[int]
    comes: bool = False


class Twin:
    """One simulation."""

    def __init__(self, plan: Plan):
        self.plan, self.machine = plan, plan.machine
        self.counts: Counter[str] = Counter()
        m = self.machine
        self.l1 = [LruCache(m.l1, m.line) for _ in range(m.processors)]
        self.l2 = LruCache(m.l2, m.line)
        self.l1_free, self.l2_free, self.memory_free = [0] * m.processors, 0, 0
        items, first = plan.traces.items.tolist(), plan.traces.first.tolist()
        self.new = deque(Ray(i, items[a:b]) for i, (a, b) in enumerate(itertools.pairwise(first)))
        self.count, self.done, self.alive = len(self.new), 0, 0
        self.chunks: list[deque[Ray]] = [deque() for _ in range(m.processors)]
        slots = m.processors * m.slots
        self.ray: list[Ray | None] = [None] * slots
        self.served: list[set[int]] = [set() for _ in range(slots)]
        self.leads: list[Row | None] = [None] * slots
        self.rows: list[list[Row | None]] = [[None] * plan.rows for _ in range(m.processors)]
        self.queues: dict[int, deque[Ray]] = {}
        self.bound = [-1] * m.processors
        self.voted, self.fetched = [0] * m.processors, [-1] * m.processors
        self.events: list[tuple[int, int]] = []
        self.parts: dict[int, dict[int, set[int]]] = {}

    def run(self) -> Counts:
        """The counts."""
        self.events = [(0, slot) for slot in range(len(self.ray))]
        last = 0
        while self.events:
            now, slot = heapq.heappop(self.events)
            self._row_came(slot, now)
            if self._leaves(slot, now):
                last = now
            then = now
            if self.ray[slot] is None:
                then = self._take(slot, now)
            ray = self.ray[slot]
            if ray is None:
                if self.plan.mode == QUEUES and self.done < self.count:
                    self._at(now + POLL, slot)
            elif then > now or ray.at == len(ray.items):
                self._at(then, slot)
            else:
                self._read(slot, ray, now)
        self.counts["cycles"] = -(-last // TICKS)
        return finished(self.plan, Counts(**{name: self.counts[name] for name in COUNTERS}))

    def _at(self, time: int, slot: int) -> None:
        heapq.heappush(self.events, (time, slot))

    def _processor(self, slot: int) -> int:
        return slot // self.machine.slots

    # --- memory

    def _parts(self, item: int) -> dict[int, set[int]]:
        """Sectors by line."""
        if item not in self.parts:
            (begin,), (end,) = self.plan.addresses.spans(np.array([item]))
            words, found = self.machine.sector // 16, self.parts.setdefault(item, {})
            for sector in range(int(begin) // words, (int(end) - 1) // words + 1):
                line, place = divmod(sector, self.machine.line // self.machine.sector)
                found.setdefault(line, set()).add(place)
        return self.parts[item]

    def _from_l2(self, line: int, sectors: set[int], now: int) -> int:
        m, counts = self.machine, self.counts
        start = max(now, self.l2_free)
        self.l2_free = start + len(sectors) * m.sector_ticks(m.l2_rate)
        arrival = start + m.l2_latency * TICKS
        counts["l2_requests"] += 1
        counts["l2_bytes"] += len(sectors) * m.sector
        found = self.l2.find(line)
        missing = sectors - found.sectors if found else sectors
        kept = self.l2.get(line)
        if not missing:
            counts["l2_hits"] += 1
            return max(arrival, kept.ready)
        start = max(arrival, self.memory_free)
        self.memory_free = start + len(missing) * m.sector_ticks(m.memory_rate)
        counts["memory_bytes"] += len(missing) * m.sector
        kept.sectors |= missing
        kept.ready = max(kept.ready, start + m.memory_latency * TICKS)
        return kept.ready

    def _bring(self, p: int, line: int, sectors: set[int], now: int, prefetched: bool = False) -> int:
        arrival = self._from_l2(line, sectors, now)
        kept = self.l1[p].get(line)
        kept.sectors |= sectors
        kept.ready = max(kept.ready, arrival)
        if prefetched:
            kept.unused |= sectors
        return kept.ready

    def _request(self, p: int, now: int) -> int:
        start = max(now, self.l1_free[p])
        self.l1_free[p] = start + TICKS
        self.counts["l1_requests"] += 1
        return start + self.machine.l1_latency * TICKS

    def _missing(self, p: int, line: int, sectors: set[int]) -> set[int]:
        found = self.l1[p].find(line)
        return sectors - found.sectors if found else sectors

    def _use_prefetched(self, line: Line, sectors: set[int]) -> None:
        self.counts["prefetched_used"] += len(line.unused & sectors) * self.machine.sector
        line.unused -= sectors

    def _read_there(self, p: int, line: int, sectors: set[int], then: int) -> int:
        kept = self.l1[p].get(line)
        self.counts["l1_hits"] += 1
        self.counts["l1_merged"] += kept.ready > then
        self._use_prefetched(kept, sectors)
        return max(then, kept.ready)

    def _read_line(self, p: int, line: int, sectors: set[int], now: int) -> int:
        then = self._request(p, now)
        missing = self._missing(p, line, sectors)
        if not missing:
            return self._read_there(p, line, sectors, then)
        found = self.l1[p].find(line)
        if found:
            self._use_prefetched(found, sectors)
        return self._bring(p, line, missing, then)

    # --- rays

    def _read(self, slot: int, ray: Ray, now: int) -> None:
        p, item = self._processor(slot), ray.items[ray.at]
        if self.plan.vote_cycles:
            ray.treelet = self._treelet(item)
            if now >= self.voted[p]:
                self.voted[p] = now + self.plan.vote_cycles * TICKS
                self._prefetch(p, now)
        done = now
        for line, sectors in self._parts(item).items():
            if self.plan.mode != ACCUMULATE:
                done = max(done, self._read_line(p, line, sectors, now))
            elif line not in self.served[slot]:
                missing = self._missing(p, line, sectors)
                if missing:
                    self._wait(p, slot, line, missing, now)
                    return
                done = max(done, self._read_there(p, line, sectors, self._request(p, now)))
                self.served[slot].add(line)
        self.served[slot].clear()
        ray.at += 1
        self.counts["items"] += 1
        self._at(done + self.machine.compute * TICKS, slot)

    def _leaves(self, slot: int, now: int) -> bool:
        ray = self.ray[slot]
        if ray is None:
            return False
        if ray.at == len(ray.items):
            self.done += 1
            self.alive -= 1
            self.counts["finished"] += 1
        elif self.plan.mode == QUEUES and self._treelet(ray.items[ray.at]) != ray.treelet:
            self._queue_traffic("queue_written", now)
            self.counts["queued"] += 1
            self._enqueue(ray)
        else:
            return False
        self.ray[slot] = None
        return True

    def _take(self, slot: int, now: int) -> int:
        p = self._processor(slot)
        if self.plan.mode != QUEUES:
            chunk = self.chunks[p]
            if not chunk:
                chunk.extend(self.new.popleft() for _ in range(min(self.machine.chunk, len(self.new))))
            self.ray[slot] = chunk.popleft() if chunk else None
            return now
        while self.new and self.alive < self.plan.alive:
            ray = self.new.popleft()
            if ray.items:
                self.alive += 1
                self._enqueue(ray)
            else:  # reads nothing
                self.done += 1
                self.counts["finished"] += 1
        waiting = {q: len(rays) for q, rays in self.queues.items() if rays}
        if not waiting:
            return now
        self._choose(p, waiting)
        chosen = self.ray[slot] = self.queues[self.bound[p]].popleft()
        chosen.treelet = self.bound[p]
        return self._queue_traffic("queue_read", now) if chosen.at else now

    # --- queues

    def _treelet(self, item: int) -> int:
        assert self.plan.treelets is not None
        return int(self.plan.treelets.of_node[item] if item >= 0 else self.plan.treelets.of_triangle[~item])

    def _enqueue(self, ray: Ray) -> None:
        self.queues.setdefault(self._treelet(ray.items[ray.at]), deque()).append(ray)

    def _queue_traffic(self, which: str, now: int) -> int:
        m = self.machine
        self.counts[which] += self.plan.ray_bytes
        if not self.plan.in_memory:
            return now + m.l1_latency * TICKS
        start = max(now, self.memory_free)
        self.memory_free = start + -(-self.plan.ray_bytes // m.sector) * m.sector_ticks(m.memory_rate)
        return start + m.memory_latency * TICKS

    def _choose(self, p: int, waiting: dict[int, int]) -> None:
        mine = self.bound[p]
        others = Counter(q for other, q in enumerate(self.bound) if other != p)
        if mine in waiting:
            short = waiting[mine] * len(waiting) < sum(waiting.values())
            if self.plan.selection == LAZY or not short or not others[mine]:
                return
        self.counts["queue_visits"] += 1
        if self.plan.selection == LAZY:
            self.bound[p] = min(waiting, key=lambda q: (others[q] > 0, -waiting[q], q))
        else:
            self.bound[p] = min(waiting, key=lambda q: (-waiting[q] / (1 + others[q]), q))

    # --- rows

    def _wait(self, p: int, slot: int, line: int, missing: set[int], now: int) -> None:
        rows = self.rows[p]
        row = next((each for each in rows if each and not each.comes and each.line == line), None)
        if row is None:
            if None not in rows:
                self._at(now + RETRY, slot)
                return
            row = rows[rows.index(None)] = Row(line, set(), [])
        row.sectors |= missing
        row.slots.append(slot)
        self.counts["queued"] += 1
        self.served[slot].add(line)
        self._fetch_rows(p, self._request(p, now))

    def _fetch_rows(self, p: int, now: int) -> None:
        while sum(1 for row in self.rows[p] if row and row.comes) < self.plan.registers:
            waiting = [row for row in self.rows[p] if row and not row.comes]
            if not waiting:
                return
            row = max(waiting, key=lambda each: len(each.slots))
            arrival = self._bring(p, row.line, row.sectors, now)
            row.comes = True
            self.counts["queue_visits"] += 1
            self.leads[row.slots[0]] = row
            for slot in row.slots:
                self._at(arrival, slot)

    def _row_came(self, slot: int, now: int) -> None:
        row, p = self.leads[slot], self._processor(slot)
        if row is not None:
            self.rows[p][next(i for i, each in enumerate(self.rows[p]) if each is row)] = None
            self.leads[slot] = None
            self._fetch_rows(p, now)

    # --- prefetching

    def _prefetch(self, p: int, now: int) -> None:
        slots = self.ray[p * self.machine.slots : (p + 1) * self.machine.slots]
        votes = Counter(ray.treelet for ray in slots if ray is not None and ray.treelet >= 0)
        best = min(votes, key=lambda t: (-votes[t], t))
        if best == self.fetched[p] or votes[best] * 1000 < round(1000 * self.plan.threshold) * sum(votes.values()):
            return
        self.fetched[p] = best
        assert self.plan.treelets is not None
        parts: dict[int, set[int]] = {}
        for is_triangle, of in enumerate((self.plan.treelets.of_node, self.plan.treelets.of_triangle)):
            for i in (of == best).nonzero()[0].tolist():
                for line, sectors in self._parts(~i if is_triangle else i).items():
                    parts.setdefault(line, set()).update(sectors)
        for line, sectors in sorted(parts.items()):
            missing = self._missing(p, line, sectors)
            if missing:
                self._bring(p, line, missing, now, True)
                self.counts["prefetched"] += len(missing) * self.machine.sector


def simulate_twin(plan: Plan) -> Counts:
    """What `simulate` says."""
    return Twin(plan).run()
