"""What the setting `debug_checks` asks of the streaming schedule between launches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from ...native.structs import to_numpy
from .queues import Queue, StreamQueues


def check_queues(queues: StreamQueues, status: wp.array, alive: int) -> None:
    """Raise `AssertionError` unless every path is in exactly one queue, all counts agree, and no entry is left over.

    `status`: of all paths; `alive`: how many the warps count. Called while no warp works.
    """
    path_count = status.size
    size, head, tail, places = (
        to_numpy(each).astype(np.int64) for each in (queues.size, queues.head, queues.tail, queues.mask)
    )
    places += 1
    waiting = (tail - head) & 0xFFFFFFFF
    _check(waiting == size, lambda q: f"queue {_name(q)} has {waiting[q]} tickets and {size[q]} tokens")
    _check(waiting <= places, lambda q: f"queue {_name(q)} holds {waiting[q]} tokens in {places[q]} places")
    room, left = to_numpy(queues.room), (places - waiting)[len(Queue) :]
    _check(room == left, lambda t: f"treelet {t} has room for {room[t]} tokens, not {left[t]}")
    ring = to_numpy(queues.ring)
    of = np.repeat(np.arange(len(size)), places)  # the queue of each entry
    # the next ticket of each entry; where its token is there, it says one more
    behind = (np.arange(len(ring)) - to_numpy(queues.first)[of] - head[of]) % places[of]
    is_there = behind < waiting[of]
    turns = (head[of] + behind + is_there).astype(np.uint32)
    agree = (ring >> 32).astype(np.uint32) == turns
    _check(agree, lambda entry: f"an entry of queue {_name(of[entry])} was not published, or not read")
    tokens = ring[is_there] & 0xFFFFFFFF
    seen = np.bincount(tokens % path_count, minlength=path_count)
    _check(seen == 1, lambda path: f"path {path} is in {seen[path]} queues, not in exactly one queue")
    free = tokens[of[is_there] == Queue.GENERATE]
    _check(to_numpy(status)[free] == 0, lambda i: f"path {free[i]} is alive and among the free slots")
    counted = path_count - len(free)
    _check(np.array([counted == alive]), lambda _: f"{counted} paths are alive, and {alive} are counted")


def _name(queue: int) -> str:
    return Queue(queue).name if queue < len(Queue) else f"of treelet {queue - len(Queue)}"


def _check(holds: np.ndarray, complaint: Callable[[int], str]) -> None:
    """Raise what `complaint` says of the first that does not hold."""
    if not holds.all():
        raise AssertionError(f"streaming schedule: {complaint(int(np.flatnonzero(~holds)[0]))}")
