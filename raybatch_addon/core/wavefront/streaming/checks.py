"""What the setting `debug_checks` asks of the streaming schedule between launches."""

from __future__ import annotations

import numpy as np
import warp as wp

from .queues import Queue, StreamQueues


def check_queues(queues: StreamQueues, status: wp.array, alive: int) -> None:
    """Raise `AssertionError` unless every path is in exactly one queue, all counts agree, and no entry is left over.

    `status`: of all paths; `alive`: how many the warps count. Called while no warp works.
    """
    path_count = status.size
    ring, first, mask = queues.ring.numpy(), queues.first.numpy(), queues.mask.numpy()
    size, head, tail = (getattr(queues, name).numpy() for name in ("size", "head", "tail"))
    seen = np.zeros(path_count, int)
    for queue in range(len(size)):
        waiting = (int(tail[queue]) - int(head[queue])) & 0xFFFFFFFF
        name = Queue(queue).name if queue < len(Queue) else f"of treelet {queue - len(Queue)}"
        _check(waiting == size[queue], f"queue {name} has {waiting} tickets and {size[queue]} tokens")
        _check(0 <= waiting <= mask[queue] + 1, f"queue {name} holds {waiting} tokens in {mask[queue] + 1} places")
        entries = ring[first[queue] : first[queue] + mask[queue] + 1]
        # the next ticket of each entry; where its token is there, it says one more
        tickets = int(head[queue]) + np.arange(mask[queue] + 1)
        turns, places = tickets + (tickets < int(head[queue]) + waiting), tickets & mask[queue]
        agree = (entries[places] >> 32).astype(np.uint32) == turns.astype(np.uint32)
        _check(agree.all(), f"an entry of queue {name} was not published, or not read")
        tokens = entries[places[:waiting]] & 0xFFFFFFFF
        np.add.at(seen, tokens % path_count, 1)
        if queue == Queue.GENERATE:
            _check((status.numpy()[tokens] == 0).all(), "a path that is alive is among the free slots")
            _check(path_count - waiting == alive, f"{path_count - waiting} paths are alive, and {alive} are counted")
    _check((seen == 1).all(), f"{(seen != 1).sum()} paths are not in exactly one queue")


def _check(holds: bool, what: str) -> None:
    if not holds:
        raise AssertionError(f"streaming schedule: {what}")
