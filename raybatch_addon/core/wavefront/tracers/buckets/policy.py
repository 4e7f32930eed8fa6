"""Which queue is served next: the specification, in plain Python, which tests hold `policy_device.py` to.

Renders run `policy_device.py`, on CPUs and on CUDA, and policies of `assigned` where the host chooses: several buckets,
treelets that rays pass at once, and those that are asked for ahead.

Bucket b stands for treelet b, and bucket `bucket_count` for the root. Bucket b has the entry queue 2 b and the exit
queue 2 b + 1. The root's exit queue holds rays that have not begun; its entry queue those that are done, which are
nobody's work here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True)
class QueueNumbers:
    """Which queue is which, with `bucket_count` treelets."""

    bucket_count: int

    @property
    def queue_total(self) -> int:
        """All queues."""
        return 2 * self.bucket_count + 2

    @property
    def done(self) -> int:
        """The queue of rays that are done."""
        return 2 * self.bucket_count

    @property
    def new(self) -> int:
        """The queue of rays that have not begun."""
        return 2 * self.bucket_count + 1

    @property
    def entries(self) -> range:
        """Entry queues of treelets."""
        return range(0, 2 * self.bucket_count, 2)

    @property
    def exits(self) -> range:
        """Exit queues of treelets."""
        return range(1, 2 * self.bucket_count, 2)

    @property
    def exits_and_new(self) -> range:
        """All exit queues, the root's too."""
        return range(1, 2 * self.bucket_count + 2, 2)


class Selection(IntEnum):
    """How a bucket is chosen."""

    MOST_FULL = 0  # the one with the most rays
    NEXT = 1  # the next after the last one that has any
    RANDOM = 2  # any of those that have any
    ALL = 3  # all of them, in one sweep
    LAZY = 4  # some, each until no ray waits there (`assigned/lazy.py`)
    BALANCED = 5  # all with more rays than the mean (`assigned/balanced.py`)


class Step(IntEnum):
    """The next step of a batched trace."""

    NOTHING = 0  # no ray waits
    TOP = 1  # an exit queue goes on through the top level
    TREELET = 2  # an entry queue visits its treelet
    SWEEP = 3  # all entry queues do, and then all exit queues
    UNBATCHED = 4  # too few rays wait: they go on alone
    SOME = 5  # queues of several buckets (`assigned/steps.py`)


@dataclass(frozen=True)
class BucketChoice:
    """A step, and the queue that it serves; -1: none in particular."""

    step: Step
    queue: int = -1


def random_key(seed: int, step: int, bucket: int) -> int:
    """A random number of 31 bits for a bucket in a step: Murmur3's finaliser over all three (Appleby 2011)."""
    key = 0x9E3779B9
    for word in (seed, step, bucket):
        key = ((key ^ (word & 0xFFFFFFFF)) * 0x85EBCA6B) & 0xFFFFFFFF
        key ^= key >> 13
        key = (key * 0xC2B2AE35) & 0xFFFFFFFF
        key ^= key >> 16
    return key >> 1


class BucketPolicy:
    """Chooses step by step."""

    def __init__(self, selection: Selection, wait_max: int, seed: int, bucket_count: int, rays_few: int = 0):
        """`bucket_count` treelets. No ray is passed over for more than `wait_max` steps (0: for as long as it takes),
        but for others that wait longer. Where no bucket has `rays_few` rays, all go on unbatched; with ALL, where there
        are no more in all."""
        self._selection, self._wait_max, self._seed, self._bucket_count, self._rays_few = (
            selection,
            wait_max,
            seed,
            bucket_count,
            rays_few,
        )
        self._last = -1  # bucket that was served last

    def choose(self, counts: Sequence[int], since: Sequence[int], step: int, overflowing: int = 0) -> BucketChoice:
        """What to do in `step`, with `counts[q]` rays in queue q, whose first came in step `since[q]`; both of length 2
        bucket_count + 2.

        With rays `overflowing` the pool of blocks has run out, and the fullest bucket is served.
        """
        buckets = range(self._bucket_count + 1)
        loads = [counts[2 * b + 1] + (counts[2 * b] if b < self._bucket_count else 0) for b in buckets]
        if sum(loads) == 0:
            return BucketChoice(Step.NOTHING)
        few = sum(loads) if self._selection == Selection.ALL else max(loads)
        if few < self._rays_few:
            return BucketChoice(Step.UNBATCHED)
        if self._selection == Selection.ALL:
            return BucketChoice(Step.SWEEP)
        waits = [
            step - first if count and q != 2 * self._bucket_count else -1
            for q, (count, first) in enumerate(zip(counts, since))
        ]
        if self._wait_max and max(waits) >= self._wait_max:
            queue = waits.index(max(waits))
        else:
            selection = Selection.MOST_FULL if overflowing else self._selection
            bucket = max((b for b in buckets if loads[b]), key=lambda b: (self._key(selection, b, loads[b], step), -b))
            entry = counts[2 * bucket] if bucket < self._bucket_count else -1
            queue = 2 * bucket + (entry < counts[2 * bucket + 1])
        self._last = queue // 2
        return BucketChoice(Step.TOP if queue % 2 else Step.TREELET, queue)

    def _key(self, selection: Selection, bucket: int, load: int, step: int) -> int:
        """The bucket with the largest is served; of equals the first."""
        if selection == Selection.MOST_FULL:
            return load
        if selection == Selection.NEXT:
            return (self._last - bucket) % (self._bucket_count + 1)
        if selection == Selection.RANDOM:
            return random_key(self._seed, step, bucket)
        raise ValueError(f"there is no rule for the selection {selection!r}: add one here and in `policy_device.py`")
