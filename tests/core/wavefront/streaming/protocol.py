"""The protocol of the streaming schedule's queues in Python, one access to shared memory at a time, so that accesses of
many warps can be put in any order.

A warp is a generator that yields before each access. It does what `native/streaming/take.h` and `put.h` say, lane by
lane. Faults that a protocol could have are there by name, to see that the checks find them.
"""

from __future__ import annotations

import random
from collections.abc import Generator
from dataclasses import dataclass, field

from raybatch_addon.core.wavefront.streaming.queues import FAIR_TURNS, Queue, ring_places

Steps = Generator[None, None, int | None]
ROUNDS = 3  # of rays, of each path


@dataclass
class Shared:
    """What all warps see, and what is known of each token beside that."""

    path_count: int
    treelet_count: int = 0
    treelet_places: int = 2  # a power of two from 2 on
    batch: int = 3
    full: int = 2
    limit: int = 0  # items to begin
    fault: str = ""  # the one that the protocol has
    begun: int = 0
    alive: int = 0
    size: list[int] = field(default_factory=list)
    room: list[int] = field(default_factory=list)  # of the rings of treelets
    head: list[int] = field(default_factory=list)
    tail: list[int] = field(default_factory=list)
    ring: list[list[tuple[int, int]]] = field(default_factory=list)  # entries: whose turn it is, and a token
    holder: list[int | None] = field(default_factory=list)  # the warp that has the token in hands; None: a queue has it
    left: list[int] = field(default_factory=list)  # rounds of the path in this slot
    items: list[int] = field(default_factory=list)  # that were begun
    ended: int = 0
    chosen: list[int] = field(default_factory=list)  # queues that were served, in order

    def __post_init__(self) -> None:
        places = ring_places(self.path_count)
        queues = len(Queue) + self.treelet_count
        counts = [places if q < len(Queue) else self.treelet_places for q in range(queues)]
        self.ring = [[(turn, 0) for turn in range(count)] for count in counts]
        self.size, self.head, self.tail = ([0] * queues for _ in range(3))
        self.room = [self.treelet_places] * self.treelet_count
        for token in range(self.path_count):
            self.ring[Queue.GENERATE][token] = token + 1, token
        self.size[Queue.GENERATE] = self.tail[Queue.GENERATE] = self.path_count
        self.holder, self.left = [None] * self.path_count, [0] * self.path_count

    def target(self, token: int, queue: int, numbers: random.Random) -> int:
        """Where the path of `token` goes from `queue`."""
        if queue == Queue.FILM:
            return Queue.GENERATE
        if queue == Queue.TRACE:
            if self.treelet_count and numbers.random() < 0.5:
                return len(Queue) + numbers.randrange(self.treelet_count)
            return Queue.SURFACE
        if queue >= Queue.TREELETS:
            return Queue.TRACE
        if queue == Queue.SURFACE:
            self.left[token] -= 1
            return Queue.FILM if self.left[token] == 0 else Queue.SHADOW
        return {Queue.SHADOW: Queue.CONNECT, Queue.CONNECT: Queue.TRACE}[Queue(queue)]


def warp(number: int, shared: Shared, numbers: random.Random) -> Steps:
    """All that a warp does in a launch."""
    picks, last, in_vain = 0, 0, -1
    while True:
        chosen = yield from _choose(shared, picks, last, in_vain)
        in_vain = -1
        if chosen is None:
            assert len(shared.items) == shared.ended == shared.limit, "a warp leaves while there is something to do"
            return None
        if chosen < 0:
            continue
        fair = picks % FAIR_TURNS == FAIR_TURNS - 1
        picks += 1
        tokens = yield from _take(number, shared, chosen)
        if not tokens:
            in_vain = chosen
            continue
        if fair:
            last = chosen
        shared.chosen.append(chosen)
        targets = [Queue.GENERATE] * len(tokens)
        if chosen == Queue.GENERATE:
            begins = yield from _begin(shared, tokens)
            targets[:begins] = [Queue.TRACE] * begins
        else:
            targets = [shared.target(token, chosen, numbers) for token in tokens]
        yield from _put(shared, chosen, tokens, targets)


def _choose(shared: Shared, picks: int, last: int, in_vain: int) -> Steps:
    """A queue, but `in_vain` only in a fair turn; -1: there is nothing to do now; None: the launch is over."""
    yield
    left = shared.limit - shared.begun
    yield
    if left <= 0 and shared.alive == 0:
        return None
    fair, best, chosen, count = picks % FAIR_TURNS == FAIR_TURNS - 1, 0, -1, len(shared.size)
    for q in range(count):
        if q == in_vain and not fair:
            continue
        yield
        size = min(shared.size[q], left) if q == Queue.GENERATE else shared.size[q]
        if size <= 0:
            continue
        rank = 15 - q if q < Queue.GENERATE else 2 if q == Queue.GENERATE else 1
        wish = size if size < shared.full else 1 << 29 | rank << 24 | size
        if fair:
            wish = (1 << 30) - (q - last - 1) % count
        if wish > best:
            best, chosen = wish, q
    return chosen


def _take(number: int, shared: Shared, queue: int) -> Generator[None, None, list[int]]:
    yield
    wanted = min(shared.size[queue], shared.batch)
    if wanted <= 0:
        return []
    yield
    seen = shared.size[queue]
    if shared.fault == "look and take apart":
        yield
    shared.size[queue] -= wanted
    n = min(max(seen, 0), wanted)
    if n < wanted and shared.fault != "too much is not given back":
        yield
        shared.size[queue] += wanted - n
    if n == 0:
        return []
    if queue > Queue.TREELETS and shared.fault != "room is not given back":
        yield
        shared.room[queue - len(Queue)] += n
    yield
    head = shared.head[queue]
    shared.head[queue] += n
    tokens = []
    for i in range(n):
        ring = shared.ring[queue]
        while True:
            yield
            turn, token = ring[(head + i) % len(ring)]
            there = (turn - head - i) % len(ring) == 1 if shared.fault == "any turn" else turn == head + i + 1
            if there or shared.fault == "read before it is published":
                break
        yield
        ring[(head + i) % len(ring)] = head + i + len(ring), 0
        assert shared.holder[token] is None, "a token is in two places"
        shared.holder[token] = number
        tokens.append(token)
    return tokens


def _begin(shared: Shared, tokens: list[int]) -> Generator[None, None, int]:
    n = len(tokens)
    if shared.fault != "begun before alive":
        yield
        shared.alive += n
    yield
    first = shared.begun
    shared.begun += n
    begins = min(max(shared.limit - first, 0), n)
    yield
    shared.alive -= n - begins if shared.fault != "begun before alive" else -begins
    for i in range(begins):
        shared.items.append(first + i)
        shared.left[tokens[i]] = ROUNDS
    return begins


def _put(shared: Shared, queue: int, tokens: list[int], targets: list[int]) -> Steps:
    for to in sorted(set(targets)):
        group = [token for token, target in zip(tokens, targets, strict=True) if target == to]
        for token in group:
            shared.holder[token] = None
        if to == Queue.GENERATE and queue != Queue.GENERATE:
            yield
            shared.ended += len(group)
            yield
            shared.alive -= len(group)
        yield from _place_all(shared, to, group)
    return None


def _place_all(shared: Shared, to: int, group: list[int]) -> Steps:
    n = len(group)
    if to > Queue.TREELETS:
        yield
        place = to - len(Queue)
        seen = shared.room[place]
        shared.room[place] -= n
        if seen < n and shared.fault != "room is not looked at":
            yield
            shared.room[place] += n
            to = Queue.TREELETS
    yield
    shared.size[to] += n
    yield
    ticket = shared.tail[to]
    shared.tail[to] += n
    ring = shared.ring[to]
    for i, token in enumerate(group):
        while True:
            yield
            if ring[(ticket + i) % len(ring)][0] == ticket + i or shared.fault == "overwrites":
                break
        yield
        ring[(ticket + i) % len(ring)] = ticket + i + 1, token
    return None
