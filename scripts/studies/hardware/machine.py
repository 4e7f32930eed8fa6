"""The machine that is simulated, and what is counted of it.

Processors have rays in flight and a first-level cache each. They share a second-level cache and memory. A cache has
lines of sectors and replaces the line that was not used for the longest time; what is missing is brought in sector by
sector. A line that is on its way is there for every later request, which waits until it has come: that is what the
registers of misses of a non-blocking cache do, of which there are as many as needed.

Time is a model: a ray reads one item, waits until all of it is there, and computes for `compute` cycles. First-level
caches take a line a cycle, the second level and memory so many bytes a cycle, each with a latency on top. What
processors compute with, and how many of them may do so at once, is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from studies.hardware.traces import Addresses, Traces
from studies.hardware.treelets import Treelets

TICKS = 16  # of a cycle: the unit of the simulated time
SINGLE, ACCUMULATE, QUEUES = 0, 1, 2  # see `engine.py`
LAZY, BALANCED = 0, 1


@dataclass(frozen=True)
class Cache:
    """A cache of `size` bytes, 0 for none; its sets need be no power of two."""

    size: int
    ways: int

    def sets(self, line: int) -> int:
        """How many there are with lines of so many bytes."""
        return self.size // (line * self.ways)


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Sizes in bytes, latencies in cycles, rates in bytes a cycle."""

    processors: int = 16
    slots: int = 64  # rays, or packets, in flight at each processor
    chunk: int = 32  # rays that a processor takes from the list at a time
    line: int = 128
    sector: int = 32
    l1: Cache = Cache(32 << 10, 4)
    l2: Cache = Cache(1 << 20, 16)
    l1_latency: int = 20
    l2_latency: int = 180
    memory_latency: int = 400
    l2_rate: int = 512
    memory_rate: int = 128
    compute: int = 8  # an item

    def __post_init__(self) -> None:
        if self.processors * self.slots > 1 << 16 or min(self.processors, self.slots, self.chunk) < 1:
            raise ValueError("a machine has 1 to 65,536 rays in flight")
        if self.line % self.sector or self.sector % 32 or self.line // self.sector > 16:
            raise ValueError("lines are 1 to 16 sectors of a multiple of 32 bytes")

    def sector_ticks(self, rate: int) -> int:
        """What a sector takes at so many bytes a cycle."""
        return max(1, self.sector * TICKS // rate)


@dataclass(kw_only=True)
class Counts:
    """What was counted; bytes unless said otherwise. The order is that of the kernel's counters (`engine.py`)."""

    l1_requests: int = 0  # lines that were asked for
    l1_hits: int = 0  # lines of which everything was there or on its way
    l1_merged: int = 0  # of those hits: on its way
    l2_requests: int = 0  # lines
    l2_hits: int = 0
    l2_bytes: int = 0  # from the second level to the first, those that were prefetched included
    memory_bytes: int = 0  # from memory to the second level, likewise
    prefetched: int = 0  # that came to the first level unasked
    prefetched_used: int = 0  # and were read before they were replaced
    queue_written: int = 0  # of rays
    queue_read: int = 0
    queue_visits: int = 0  # number: times that a processor was given a queue, or a row of waiting rays was fetched
    queued: int = 0  # number: rays that were put into queues, or waited in rows
    items: int = 0  # number: nodes and triangles that were read
    finished: int = 0  # number of rays, or packets
    cycles: int = 0  # when the last one ended
    rays: int = 0  # number


COUNTERS = [each.name for each in fields(Counts)]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a policy makes of rays and a machine: what is simulated."""

    traces: Traces
    addresses: Addresses
    machine: Machine
    rays: int  # of which the traces are; more than these have where rays go in packets
    mode: int = SINGLE
    treelets: Treelets | None = None
    rows: int = 64  # ACCUMULATE: at each processor
    registers: int = 16  # ACCUMULATE: rows that are on their way at most, at each processor
    selection: int = LAZY  # QUEUES
    alive: int = 16_384  # QUEUES: rays that are in flight or wait
    ray_bytes: int = 0  # QUEUES: written and read for a ray that waits
    in_memory: bool = False  # QUEUES: whether queues lie there, or on the chip
    vote_cycles: int = 0  # between votes on what is prefetched, 0: nothing is
    threshold: float = 0.0  # share of the rays in flight that a treelet needs for that
    sorted_bytes: int = 0  # for each ray, to memory and back once, before it begins
