"""Queues of the streaming schedule: bounded rings on the device that any warp takes from and puts into.

A token is a ray slot (`wavefront/rays.py`), or the number of a path, which is the slot of its extending ray. A path has
one token, which is in one queue or in the hands of one warp. So a ring with places for all paths is never full, and a
warp never waits for room.

The protocol is that of the broker queue (Kerbl, Kenzel, Mueller, Schmalstieg and Steinberger 2018, "The broker queue: a
fast, linearizable FIFO queue for fine-granular work distribution on the GPU"), a batch at a time: `size` says how many
tokens may still be taken. Who takes subtracts what it wants, has as many tokens as were there before that, adds the
rest again, and draws as many tickets of `head`; who puts adds to it and draws tickets of `tail`. For the small rings of
treelets `room` counts free places in the same way. An entry of the ring says whose turn it is (Vyukov, "Bounded MPMC
queue", 1024cores.net): that of a ticket whose token is to come, or of who has the same ticket to take it. Why nobody
waits for ever is argued in docs/streaming.md.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import warp as wp

from ...bvh.treelets.tree import TreeletTree
from ...device.kernel import KERNEL_OPTIONS
from ...native.build import native_source
from ...settings.info import INT_MAX
from ..rays import trail_words

LEAVE = -1  # what `take_tokens` returns when a launch is over


class Queue(IntEnum):
    """The queues that there are always, a later stage of a path before an earlier one."""

    FILM = 0  # paths at their end
    BACKGROUND = 1  # paths whose extending ray left the scene
    SURFACE = 2  # paths whose extending ray met a surface
    CONNECT = 3  # shadow rays that are back
    SHADOW = 4  # shadow rays that begin, where they are traced by themselves
    TRACE = 5  # rays that begin; in cut trees also those that go on behind a treelet
    GENERATE = 6  # free slots
    TREELETS = 7  # rays that found no place in the queue of their treelet; those of treelets are behind


class Counter(IntEnum):
    """Indices of what warps count in a launch."""

    BEGUN = 0  # items that were begun, or tried to
    ALIVE = 1  # paths alive; stays from launch to launch
    WORK = 2  # tokens taken
    LEAVE = 3  # not 0: the launch is over
    FAULT = 4  # not 0: 1 + a queue in which an entry did not come to be what it was waited for
    ENDED = 5  # paths that came to their end
    RAYS = 6  # extending rays that began, those from the camera too
    SHADOW_RAYS = 7  # shadow rays that began


class Word(IntEnum):
    """Indices of what a warp keeps between its calls."""

    HELD = 0  # tokens in its hands
    FROM = 1  # the queue that they were taken from
    ITEM = 2  # GENERATE: the first item that it begins, of the launch
    BEGINS = 3  # GENERATE: how many
    PICKS = 4  # queues chosen so far
    LAST = 5  # the queue of its last fair turn
    CURSOR = 6  # for traversals, which hand out rays to lanes


# A warp's choices after which one goes to the next queue in turn
FAIR_TURNS = 16
# How often a warp looks for work in vain before it leaves the launch to others [200 ns], and looks at an entry before
# it gives up: others need some instructions for what they wait for
_IDLE_MOST, _TRIES_MOST = 1 << 16, 1 << 26
IN_TURN, AT_RANDOM = 1, 2  # `StreamQueues.selection`; 0: the longest queue


@wp.struct
class StreamQueues:
    """Device side of the queues of one worker, and of its warps."""

    # entries of all queues, a ring behind another: a token, and in the upper 32 bits a ticket, while that token is to
    # come, or one more while it is there
    ring: wp.array(dtype=wp.int64)
    first: wp.array(dtype=wp.int64)  # where the ring of each queue begins
    mask: wp.array(dtype=int)  # its places, a power of two from 2 on, less 1
    # tokens that may be taken; too few, down to -batch for each warp, while warps subtract and add again
    size: wp.array(dtype=int)
    room: wp.array(dtype=int)  # free places of the ring of each treelet; too few, down to -32 for each warp, likewise
    head: wp.array(dtype=int)  # tickets taken so far, as 32 bits that run over
    tail: wp.array(dtype=int)  # tickets given so far
    counters: wp.array(dtype=int)  # by `Counter`
    warps: wp.array2d(dtype=int)  # by warp and `Word`
    tokens: wp.array2d(dtype=int)  # in the hands of each warp, shape [warps, batch]
    targets: wp.array2d(dtype=int)  # the queue that each of them goes to
    locations: wp.array2d(dtype=int)  # while they are traced: `NEW`, `DONE` or a treelet
    batch: int  # tokens that a warp takes at most
    full: int  # tokens in a queue from which on a warp need not wait for more
    full_treelet: int  # the same for queues of treelets, whose rings may be smaller: at most half of their places
    limit: int  # items that a launch may begin
    budget: int  # tokens that a launch takes, about
    shadow_queue: int  # where shadow rays begin: SHADOW, or TRACE
    selection: int  # among queues of treelets


def ring_places(least: int) -> int:
    """Places of a ring for `least` tokens: a power of two."""
    return max(2, 1 << max(least - 1, 0).bit_length())


def treelet_places(path_count: int, treelet_count: int) -> int:
    """Places of the ring of one of `treelet_count` treelets: together four times as many as paths, but no ring has
    less than 64 or more than all paths need.
    """
    return min(ring_places(max(4 * path_count // max(treelet_count, 1), 64)), ring_places(path_count))


def queue_bytes(path_count: int, treelet_count: int) -> int:
    """Memory of the rings [bytes]."""
    places = len(Queue) * ring_places(path_count) + treelet_count * treelet_places(path_count, treelet_count)
    return 8 * places


def stream_bytes_per_path(path_count: int, shadow_rays: bool, cut: TreeletTree | None) -> int:
    """Device memory that the schedule takes for each of `path_count` paths alive [bytes]; `cut`: the tree, where rays
    wait at treelets.
    """
    size = -(-queue_bytes(path_count, cut.treelet_count if cut else 0) // path_count)
    size += 12  # a token, its target and where its ray is: warps have at most as many in hands as there are paths
    if cut:  # a location, and how far a ray has come
        size += (1 + shadow_rays) * (4 + 4 * trail_words(cut.levels) + 4 * cut.instancing)
    return size


def allocate_queues(
    path_count: int, treelet_count: int, warp_count: int, batch: int, full: int, device: wp.Device
) -> StreamQueues:
    """Empty queues for `path_count` paths, and `warp_count` warps that take `batch` tokens at a time; raises
    `MemoryError` where they have more places than an array can have.
    """
    places = [ring_places(path_count)] * len(Queue) + [treelet_places(path_count, treelet_count)] * treelet_count
    if sum(places) > INT_MAX:
        raise MemoryError(f"queues of {path_count:,} paths have more places than can be numbered")
    queues = StreamQueues()
    queues.ring = wp.empty(sum(places), dtype=wp.int64, device=device)
    queues.first = wp.array(np.cumsum([0, *places[:-1]]), dtype=wp.int64, device=device)
    queues.mask = wp.array(np.array(places) - 1, dtype=int, device=device)
    for name in ("size", "head", "tail"):
        setattr(queues, name, wp.zeros(len(places), dtype=int, device=device))
    queues.room = wp.empty(treelet_count, dtype=int, device=device)
    queues.counters = wp.zeros(len(Counter), dtype=int, device=device)
    queues.warps = wp.zeros((warp_count, len(Word)), dtype=int, device=device)
    for name in ("tokens", "targets", "locations"):
        setattr(queues, name, wp.zeros((warp_count, batch), dtype=int, device=device))
    queues.batch, queues.full = batch, full
    queues.full_treelet = min(full, treelet_places(path_count, treelet_count) // 2)
    queues.shadow_queue = int(Queue.SHADOW)
    fill_queues(queues, path_count)
    return queues


@wp.kernel(**KERNEL_OPTIONS)
def fill_kernel(ring: wp.array(dtype=wp.int64), mask: int, tokens: int):
    """Entries of rings of `mask` + 1 places: tokens 0 to `tokens` in the first ones, the others for tickets from 0."""
    i = wp.tid()
    entry = wp.int64(i & mask) << wp.int64(32)
    if i < tokens:
        entry = (wp.int64(i + 1) << wp.int64(32)) | wp.int64(i)
    ring[i] = entry


def fill_queues(queues: StreamQueues, path_count: int) -> None:
    """No path is alive: all `path_count` tokens are in GENERATE."""
    places, treelets, device = ring_places(path_count), queues.size.size - len(Queue), queues.ring.device
    for queue in Queue:
        tokens = path_count if queue is Queue.GENERATE else 0
        ring = queues.ring[queue * places : (queue + 1) * places]
        wp.launch(fill_kernel, places, [ring, places - 1, tokens], device=device)
    if treelets:
        rest = queues.ring[len(Queue) * places :]
        wp.launch(fill_kernel, rest.size, [rest, treelet_places(path_count, treelets) - 1, 0], device=device)
    for name in ("size", "head", "tail"):
        getattr(queues, name).zero_()
    queues.room.fill_(treelet_places(path_count, treelets))
    for array in (queues.size, queues.tail):
        array[Queue.GENERATE : Queue.GENERATE + 1].fill_(path_count)
    queues.counters.zero_()
    queues.warps.zero_()


def _source(header: str) -> str:
    names = {each.name: int(each) for each in Queue}
    names |= {each.name: int(each) for each in Counter} | {each.name: int(each) for each in Word}
    return native_source(
        "streaming/warp.h",
        header,
        WARP_WORDS=len(Word),
        FAIR_TURNS=FAIR_TURNS,
        IDLE_MOST=_IDLE_MOST,
        TRIES_MOST=_TRIES_MOST,
        IN_TURN=IN_TURN,
        AT_RANDOM=AT_RANDOM,
        **names,
    )


@wp.func_native(_source("streaming/take.h"))
def take_tokens(queues: StreamQueues, thread: int) -> int:
    """A warp takes tokens from the queue that it chooses, which is returned; `LEAVE`: the launch is over. All of its
    lanes call it together.
    """


@wp.func_native(_source("streaming/put.h"))
def put_tokens(queues: StreamQueues, thread: int):
    """A warp puts the tokens that it holds into their `targets`. All of its lanes call it together."""


@wp.func_native(native_source("streaming/lanes.h"))
def lane_count() -> int:
    """Lanes of a warp: 32 on CUDA, 1 on a CPU."""


@wp.func_native(native_source("streaming/join.h"))
def join_lanes():
    """The lanes of a warp wait for each other, and see what each of them wrote."""


def warp_size(device: wp.Device) -> int:
    """`lane_count`, for the host."""
    return 32 if device.is_cuda else 1
