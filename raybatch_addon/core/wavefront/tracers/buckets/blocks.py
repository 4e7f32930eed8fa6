"""The memory of queues: blocks of one pool, and what is checked of them.

A queue's rays lie in blocks of `queue_size` entries. All of its blocks but the last are full, so the ray at position p
of a queue lies in its block number p // queue_size: no list has to be walked. Where all blocks are taken, rays lie in
single entries behind the blocks, the overflow, until their queue is served.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ....bvh.tree import DONE, NEW
from ....native.structs import to_numpy

# Entries of `Blocks.state`
FREE, OVERFLOW, IN_USE_PEAK, SHORT, WAIT_MAX, STEP, WAITING, STATE_SIZE = range(8)

# Places that can be numbered
PLACES_MAX = 2**31 - 1
# Queues of 1024 rays keep the launches over blocks small; more would only waste entries of queues that are nearly empty
QUEUE_SIZE_MAX = 1024


@wp.struct
class Blocks:
    """Device side of all queues."""

    slots: wp.array(dtype=int)  # rays, shape [block_count * queue_size + overflow entries]
    # by block
    owner: wp.array(dtype=int)  # its queue, or -1
    link: wp.array(dtype=int)  # CPU: the queue's next block; CUDA: the block's number in its queue
    free: wp.array(dtype=int)  # stack of blocks without an owner; `state[FREE]` of them
    # by queue
    first: wp.array(dtype=int)  # its first block (CPU)
    open: wp.array(dtype=int)  # its last block
    counts: wp.array(dtype=int)  # its rays
    in_blocks: wp.array(dtype=int)  # those in blocks; the others are in the overflow
    since: wp.array(dtype=int)  # the step in which it was empty last
    # by entry of the overflow
    overflow_queue: wp.array(dtype=int)  # the ray's queue, or -1
    overflow_link: wp.array(dtype=int)  # CPU: the next entry of the same queue, or of the free entries
    # CPU, by queue: its first entry of the overflow, or -1; then that of the free entries
    overflow_first: wp.array(dtype=int)
    state: wp.array(dtype=int)  # shape [STATE_SIZE]
    put: wp.array(
        dtype=wp.int64
    )  # times a ray was put into a queue so far, shape [1]: more than 32 bits hold within minutes
    queue_size: int
    overflow_at: int  # first entry of the overflow


@wp.struct
class QueueRule:
    """Which queue stands for which treelet: queue = treelet * scale + shift."""

    scale: int
    shift: int
    done_queue: int  # queue of rays that are done; -1: they leave
    new_queue: int  # queue of rays that have not begun; -1: they are ignored


@wp.struct
class Moves:
    """Scratch of transactions."""

    # by ray of a batch
    keys: wp.array(dtype=int)  # its queue; the number of queues: none. Twice as long, for sorting
    order: wp.array(dtype=int)  # its place in the batch. Twice as long
    # by queue
    run_first: wp.array(dtype=int)  # its first ray among those sorted
    run_end: wp.array(dtype=int)
    amount: wp.array(dtype=int)  # put: new blocks; take: rays
    amount_first: wp.array(dtype=int)  # sums of it, one entry more
    part: wp.array(dtype=int)  # take: blocks
    part_first: wp.array(dtype=int)  # sums of it, one entry more
    mask: wp.array(dtype=int)  # take: 1: chosen
    # by block
    listed: wp.array(dtype=int)  # blocks that are taken
    # of the overflow
    flags: wp.array(dtype=int)  # by ray of a batch
    flags_first: wp.array(dtype=int)
    spare: wp.array(dtype=int)  # by entry of the overflow
    spare_first: wp.array(dtype=int)
    spare_list: wp.array(dtype=int)
    total: wp.array(dtype=int)  # put: rays that found a queue, shape [1]


@wp.func
def blocks_for(rays: int, size: int) -> int:
    """Blocks that hold so many rays."""
    return rays // size + wp.where(rays % size != 0, 1, 0)


@wp.func
def queue_of(rule: QueueRule, location: int) -> int:
    """The queue in which a ray waits whose `location` is a treelet, `NEW` or `DONE`."""
    if location >= 0:
        return location * rule.scale + rule.shift
    return wp.where(location == DONE, rule.done_queue, rule.new_queue)


@wp.func
def location_of(rule: QueueRule, queue: int) -> int:
    """Inverse of `queue_of`, whatever the shift."""
    if queue == rule.new_queue:
        return NEW
    if queue == rule.done_queue:
        return DONE
    return queue // rule.scale


@dataclass(frozen=True)
class PoolSize:
    """The number of entries that there are."""

    queue_size: int  # rays of a block
    block_count: int
    overflow: int  # single entries: with them every ray has one, however the rays spread over the queues

    @property
    def entry_count(self) -> int:
        """Entries in all."""
        return self.block_count * self.queue_size + self.overflow


def pool_size(queue_total: int, queue_size: int, queue_count: int, slot_count: int) -> PoolSize:
    """Sizes for `slot_count` rays in `queue_total` queues; `queue_size` rays a block and `queue_count` blocks, 0 for
    what suits.

    Chosen freely, blocks never run out: every queue may have one that is nearly empty, and these take a quarter of the
    entries at most. Otherwise the pool is at most twice as large as the rays need, or as many blocks as asked for.
    """
    slot_count = max(1, slot_count)
    if not queue_size:
        if queue_count:
            queue_size = -(-5 * slot_count // (4 * queue_count))
        else:
            queue_size = max(1, slot_count // (4 * queue_total))
        queue_size = min(1 << (queue_size.bit_length() - 1), QUEUE_SIZE_MAX)
    queue_size = min(queue_size, slot_count)  # no block gets more rays
    most = min(-(-slot_count // queue_size) + queue_total, slot_count)  # each has at least a ray
    if not queue_count:
        queue_count = min(most, max(1, 2 * slot_count // queue_size))
    # entries are numbered by 31 bits, and the overflow has fewer than there are rays
    queue_count = min(queue_count, most, max(1, (PLACES_MAX - slot_count) // queue_size))
    # blocks run out with as few rays as this in them: one in the last block of each queue, all other blocks full
    queues = min(queue_total, queue_count)
    held = queues + (queue_count - queues) * queue_size
    return PoolSize(queue_size, queue_count, max(0, slot_count - held))


def pool_bytes(size: PoolSize, queue_total: int, is_cuda: bool) -> int:
    """Memory of the pool [bytes]."""
    return 4 * (size.entry_count + 3 * size.block_count + 6 * queue_total + size.overflow * (1 if is_cuda else 2))


def allocate_blocks(size: PoolSize, queue_total: int, device: wp.Device, host: bool) -> Blocks:
    """`Blocks`, all free; `host`: with the chains that one CPU thread goes along."""
    blocks = Blocks()
    for name, count in (
        ("slots", size.entry_count),
        ("owner", size.block_count),
        ("link", size.block_count),
        ("free", size.block_count),
        ("first", queue_total if host else 0),
        ("open", queue_total),
        ("counts", queue_total),
        ("in_blocks", queue_total),
        ("since", queue_total),
        ("overflow_queue", size.overflow),
        ("overflow_link", size.overflow if host else 0),
        ("overflow_first", queue_total + 1 if host else 0),
        ("state", STATE_SIZE),
    ):
        setattr(blocks, name, wp.zeros(count, dtype=int, device=device))
    blocks.put = wp.zeros(1, dtype=wp.int64, device=device)
    blocks.queue_size, blocks.overflow_at = size.queue_size, size.block_count * size.queue_size
    clear_blocks(blocks)
    return blocks


def clear_blocks(blocks: Blocks) -> None:
    """No ray waits any more; what was counted stays."""
    for array in (blocks.owner, blocks.first, blocks.open, blocks.overflow_queue, blocks.overflow_first):
        array.fill_(-1)
    for array in (blocks.counts, blocks.in_blocks):
        array.zero_()
    block_count, overflow = blocks.owner.size, blocks.overflow_queue.size
    blocks.free.assign(np.arange(block_count - 1, -1, -1, dtype=np.int32))
    if blocks.overflow_link.size:
        blocks.overflow_link.assign(np.append(np.arange(1, overflow, dtype=np.int32), np.int32(-1)))
        blocks.overflow_first[-1:].zero_()
    state = to_numpy(blocks.state).copy()
    state[FREE], state[OVERFLOW], state[WAITING] = block_count, 0, 0
    blocks.state.assign(state)


class BlockCheck:
    """Looks at all queues after a transaction; for debugging, and slow."""

    def __init__(self, blocks: Blocks, slot_count: int):
        self._blocks = blocks
        self._queue = np.full(slot_count, -1, np.int32)  # of every ray that waits

    def put(self, slots: np.ndarray, locations: np.ndarray, rule: QueueRule) -> None:
        """The rays `slots` were put into their queues; raises `AssertionError` for what is wrong."""
        queues = np.where(
            locations >= 0,
            locations * rule.scale + rule.shift,
            np.where(locations == DONE, rule.done_queue, rule.new_queue),
        )
        slots, queues = slots[queues >= 0], queues[queues >= 0]
        assert len(np.unique(slots)) == len(slots), f"rays {_some(_repeated(slots))} were put twice"
        known = (slots >= 0) & (slots < len(self._queue))
        assert known.all(), f"there are no rays {_some(slots[~known])}; there are {len(self._queue)}"
        strange = queues[queues >= self._blocks.counts.size]
        assert not len(strange), f"there are no queues {_some(strange)}"
        inside = slots[self._queue[slots] >= 0]
        assert not len(inside), f"rays {_some(inside)} were put, but wait in queues {_some(self._queue[inside])}"
        self._queue[slots] = queues
        self._look()

    def take(self, slots: np.ndarray, locations: np.ndarray, rule: QueueRule, chosen: np.ndarray) -> None:
        """The rays `slots` were taken from the queues `chosen`; raises `AssertionError` for what is wrong."""
        assert len(np.unique(slots)) == len(slots), f"rays {_some(_repeated(slots))} were taken twice"
        queues = self._queue[slots]
        outside = slots[queues < 0]
        assert not len(outside), f"rays {_some(outside)} were taken, but wait nowhere"
        strange = queues[~np.isin(queues, chosen)]
        assert not len(strange), f"rays were taken from queues {_some(strange)}, which were not chosen"
        left = np.where(queues == rule.new_queue, NEW, np.where(queues == rule.done_queue, DONE, queues // rule.scale))
        wrong = slots[left != locations]
        assert not len(wrong), f"rays {_some(wrong)} were taken, and it is not told where they waited"
        self._queue[slots] = -1
        self._look()

    def clear(self) -> None:
        """No ray waits any more."""
        self._queue[:] = -1
        self._look()

    def _look(self) -> None:
        blocks, size = self._blocks, self._blocks.queue_size
        owner, counts, in_blocks, state = (
            to_numpy(each) for each in (blocks.owner, blocks.counts, blocks.in_blocks, blocks.state)
        )
        queue_total, free = len(counts), to_numpy(blocks.free)[: state[FREE]]
        is_free = np.zeros(len(owner), bool)
        is_free[free] = True
        assert is_free.sum() == len(free), f"blocks {_some(_repeated(free))} are free twice"
        both = np.flatnonzero(is_free & (owner >= 0))
        assert not len(both), f"blocks {_some(both)} are free, but belong to queues {_some(owner[both])}"
        lost = np.flatnonzero(~is_free & (owner < 0))
        assert not len(lost), f"blocks {_some(lost)} are neither free nor a queue's"
        strange = np.flatnonzero((owner < -1) | (owner >= queue_total))
        assert not len(strange), (
            f"blocks {_some(strange)} belong to queues {_some(owner[strange])}, which there are not"
        )
        owned = np.bincount(owner[owner >= 0], minlength=queue_total)
        wrong = np.flatnonzero(owned != -(-in_blocks // size))
        assert not len(wrong), (
            f"queues {_some(wrong)} have {_some(owned[wrong])} blocks for {_some(in_blocks[wrong])} rays"
        )
        overflow = to_numpy(blocks.overflow_queue)
        over = np.bincount(overflow[overflow >= 0], minlength=queue_total)
        wrong = np.flatnonzero(counts != in_blocks + over)
        assert not len(wrong), (
            f"queues {_some(wrong)} count {_some(counts[wrong])} rays, and hold {_some((in_blocks + over)[wrong])}"
        )
        assert over.sum() == state[OVERFLOW], (
            f"{state[OVERFLOW]} rays are counted in the overflow, which holds {over.sum()}"
        )
        assert counts.sum() == state[WAITING], f"{state[WAITING]} rays are counted in all, and {counts.sum()} by queue"
        entry, queue = self._entries(owner, in_blocks)
        filled = np.flatnonzero(overflow >= 0)
        entry = np.concatenate([entry, blocks.overflow_at + filled])
        queue = np.concatenate([queue, overflow[filled]])
        slots = to_numpy(blocks.slots)[entry]
        assert len(np.unique(slots)) == len(slots), f"rays {_some(_repeated(slots))} wait twice"
        wrong = slots[self._queue[slots] != queue]
        assert not len(wrong), f"rays {_some(wrong)} wait in queues other than those that they were put into"
        missing = np.setdiff1d(np.flatnonzero(self._queue >= 0), slots)
        assert not len(missing), f"rays {_some(missing)} are lost"

    def _entries(self, owner: np.ndarray, in_blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Entries of blocks that hold rays, and their queues."""
        blocks, size = self._blocks, self._blocks.queue_size
        last = to_numpy(blocks.open)
        if blocks.first.size:
            rank = _ranks_of_chains(blocks, owner, in_blocks)
        else:
            rank = to_numpy(blocks.link)
        used = np.flatnonzero(owner >= 0)
        number = rank[used] * np.int64(len(in_blocks)) + owner[used]
        assert len(np.unique(number)) == len(used), "two blocks have the same number in their queue"
        fill = in_blocks[owner[used]] - rank[used] * size
        assert (fill > 0).all() and (rank[used] >= 0).all(), f"blocks {_some(used[fill <= 0])} are empty"
        ends = fill <= size
        wrong = used[ends][last[owner[used[ends]]] != used[ends]]
        assert not len(wrong), f"blocks {_some(wrong)} are the last of their queues, which do not know it"
        empty = np.flatnonzero((in_blocks == 0) & (last != -1))
        assert not len(empty), f"queues {_some(empty)} are empty, but have a last block"
        inside = np.arange(size)[None, :] < fill[:, None]
        entry = (used[:, None] * np.int64(size) + np.arange(size)[None, :])[inside]
        return entry, np.broadcast_to(owner[used][:, None], inside.shape)[inside]


def _ranks_of_chains(blocks: Blocks, owner: np.ndarray, in_blocks: np.ndarray) -> np.ndarray:
    rank = np.full(len(owner), -1, np.int64)
    first, link = to_numpy(blocks.first), to_numpy(blocks.link)
    for queue in np.flatnonzero(in_blocks):
        block = first[queue]
        for number in range(-(-int(in_blocks[queue]) // blocks.queue_size)):
            assert owner[block] == queue, f"block {block} is in queue {queue}, and belongs to {owner[block]}"
            rank[block] = number
            block = link[block]
    return rank


def _repeated(values: np.ndarray) -> np.ndarray:
    unique, counts = np.unique(values, return_counts=True)
    return unique[counts > 1]


def _some(values: np.ndarray) -> str:
    """A few of `values`, for a message."""
    return f"{values[:8].tolist()}{' ...' if len(values) > 8 else ''}"
