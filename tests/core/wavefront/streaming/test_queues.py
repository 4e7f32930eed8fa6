"""The queues of the streaming schedule as they are compiled, used by several threads at once."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.devices import load_module, start_warp
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.wavefront.streaming.checks import check_queues
from raybatch_addon.core.wavefront.streaming.queues import (
    Counter,
    Queue,
    StreamQueues,
    Word,
    allocate_queues,
    fill_queues,
    lane_count,
    put_tokens,
    queue_bytes,
    take_tokens,
    treelet_places,
    warp_size,
)
from tests.support.under_test import DEVICE

ROUNDS = 3  # of rays, of each path
PATHS = 300 if DEVICE == "cpu" else 3_000  # at most
_TRACE, _SURFACE, _GENERATE = int(Queue.TRACE), int(Queue.SURFACE), int(Queue.GENERATE)
_FILM, _TREELETS = int(Queue.FILM), int(Queue.TREELETS)
_HELD, _BEGINS, _ITEM = int(Word.HELD), int(Word.BEGINS), int(Word.ITEM)


@wp.kernel(**KERNEL_OPTIONS)
def walk_kernel(
    queues: StreamQueues,
    first: int,
    rounds: wp.array(dtype=int),
    status: wp.array(dtype=int),
    begun: wp.array(dtype=int),
):
    """Paths that go from queue to queue, without rays: of each round one visit to a treelet. On a CPU a warp is a
    thread, here that of one launch, number `first`.
    """
    thread = first + wp.tid()
    warp = thread / lane_count()
    treelets = queues.size.shape[0] - _TREELETS - 1
    queue = int(take_tokens(queues, thread))
    while queue >= 0:
        for i in range(thread % lane_count(), queues.warps[warp, _HELD], lane_count()):
            token = queues.tokens[warp, i]
            target = int(_TRACE)
            if queue == _GENERATE:
                target = _GENERATE
                if i < queues.warps[warp, _BEGINS]:
                    begun[queues.warps[warp, _ITEM] + i] += 1
                    rounds[token] = 0
                    status[token] = 1
                    target = _TRACE
            elif queue == _TRACE:
                rounds[token] += 1
                target = _SURFACE
                if rounds[token] % 2 == 1 and treelets > 0:
                    target = _TREELETS + 1 + (7 * token + rounds[token]) % treelets
            elif queue == _SURFACE:
                if rounds[token] >= 2 * ROUNDS:
                    target = _FILM
            elif queue == _FILM:
                status[token] = 0
                target = _GENERATE
            queues.targets[warp, i] = target
        put_tokens(queues, thread)
        queue = take_tokens(queues, thread)


@pytest.fixture(scope="module")
def on():
    """The device under test."""
    start_warp()
    device = wp.get_device(DEVICE)
    load_module(walk_kernel, device)
    return device


def launch(queues, warps, arrays, device):
    """A launch of as many warps, on a CPU each on a thread; what they counted."""
    queues.counters[Counter.BEGUN : Counter.BEGUN + 1].zero_()
    queues.counters[Counter.WORK :].zero_()

    def work(warp: int, threads: int = 1) -> None:
        wp.launch(walk_kernel, threads, [queues, warp, *arrays], device=device)

    if device.is_cuda:
        work(0, warps * warp_size(device))
    elif warps == 1:
        work(0)
    else:
        with ThreadPoolExecutor(warps) as pool:
            list(pool.map(work, range(warps)))
    return dict(zip(Counter, queues.counters.numpy().tolist(), strict=True))


def begin_at(queues, ticket):
    """Tickets begin at `ticket`, a multiple of all places, from which they run over 32 bits where it is below 0."""
    for array in (queues.head, queues.tail):
        array.assign(array.numpy() + ticket)
    ring = queues.ring.numpy()
    queues.ring.assign(ring + (ticket << 32))


@pytest.mark.parametrize("warps", [1, 2, 4] if DEVICE == "cpu" else [1, 4, 256, 4096])
def test_all_items_are_begun_and_ended_once_whatever_warps_do(on, warps, examples):
    numbers = np.random.default_rng(warps)
    for _ in range(examples(900 if warps > 1 and DEVICE == "cpu" else 90)):
        paths, treelets = int(numbers.integers(1, PATHS)), int(numbers.integers(0, 5))
        batch, items = int(numbers.integers(1, 40)), int(numbers.integers(0, 3 * PATHS))
        queues = allocate_queues(paths, treelets, warps, batch, int(numbers.integers(1, batch + 1)), on)
        queues.selection = int(numbers.integers(0, 3))
        if numbers.random() < 0.5:
            begin_at(queues, -(1 << 18) * int(numbers.integers(1, 9)))
        rounds, status, seen = (wp.zeros(each, dtype=int, device=on) for each in (paths, paths, items + 1))
        begun = ended = alive = 0
        budget = int(numbers.integers(1, 20 * PATHS))
        while begun < items or alive:
            queues.limit, queues.budget = items - begun, budget
            counted = launch(queues, warps, (rounds, status, seen[begun:]), on)
            assert counted[Counter.FAULT] == 0 and counted[Counter.WORK] > 0
            alive = counted[Counter.ALIVE]
            check_queues(queues, status, alive)
            begun += min(counted[Counter.BEGUN], items - begun)
            ended += counted[Counter.ENDED]
        assert ended == items and (seen.numpy()[:items] == 1).all()


def test_no_items_are_begun_beyond_the_limit_and_a_launch_ends_with_its_budget(on):
    queues = allocate_queues(64, 2, 1, 8, 8, on)
    arrays = [wp.zeros(64, dtype=int, device=on) for _ in range(2)] + [wp.zeros(1000, dtype=int, device=on)]
    queues.limit, queues.budget = 1000, 100
    counted = launch(queues, 1, arrays, on)
    assert 100 <= counted[Counter.WORK] < 100 + 8 and counted[Counter.ALIVE] > 0
    check_queues(queues, arrays[1], counted[Counter.ALIVE])
    queues.limit, queues.budget = 0, 1 << 29
    counted = launch(queues, 1, arrays, on)
    assert counted[Counter.ALIVE] == 0 and arrays[2].numpy().max() == 1
    fill_queues(queues, 64)
    check_queues(queues, wp.zeros(64, dtype=int, device=on), 0)


@pytest.mark.skipif(DEVICE != "cpu", reason="a GPU waits for some seconds")
@pytest.mark.parametrize("queue", [_GENERATE, _TRACE], ids=["to take", "to put"])
def test_an_entry_that_never_comes_ends_the_launch_and_nothing_is_done_with_it(on, queue):
    """The first ticket of GENERATE was never put, or that of TRACE never taken."""
    queues = allocate_queues(8, 0, 1, 4, 4, on)
    ring, first = queues.ring.numpy(), int(queues.first.numpy()[queue])
    ring[first] = 7 << 32
    queues.ring.assign(ring)
    queues.limit, queues.budget = 8, 1 << 20
    rounds, status, begun = (wp.zeros(each, dtype=int, device=on) for each in (8, 8, 8))
    counted = launch(queues, 1, (rounds, status, begun), on)
    assert counted[Counter.FAULT] == 1 + queue
    assert queues.ring.numpy()[first] == 7 << 32  # neither taken nor written over
    assert status.numpy().sum() == begun.numpy().sum() == (0 if queue == _GENERATE else 4)


def test_checks_find_what_is_wrong(on):
    status = wp.zeros(8, dtype=int, device=on)

    def broken(change) -> str:
        queues = allocate_queues(8, 1, 1, 4, 4, on)
        change(queues)
        with pytest.raises(AssertionError, match="streaming schedule") as raised:
            check_queues(queues, status, 0)
        return str(raised.value)

    def lose_one(queues):
        queues.head[_GENERATE : _GENERATE + 1].fill_(1)
        queues.size[_GENERATE : _GENERATE + 1].fill_(7)

    def twice(queues):
        ring = queues.ring.numpy()
        ring[int(queues.first.numpy()[_GENERATE])] += 1
        queues.ring.assign(ring)

    assert "tickets" in broken(lambda queues: queues.size[_TRACE : _TRACE + 1].fill_(1))
    assert "treelet 0 has room for 15 tokens, not 8" in broken(lambda queues: queues.room.fill_(15))
    assert "not published, or not read" in broken(lose_one)
    assert "not in exactly one queue" in broken(twice)


def test_a_treelets_queue_is_full_before_its_ring_is(on):
    for paths, treelets, batch in ((64, 2, 32), (4096, 1000, 512), (1 << 16, 3, 512)):
        queues = allocate_queues(paths, treelets, 1, batch, batch // 2, on)
        assert 1 <= queues.full_treelet <= min(batch // 2, treelet_places(paths, treelets) // 2)


def test_rings_have_room_for_all_paths_and_those_of_treelets_for_some():
    assert treelet_places(1 << 20, 1000) == 8192 and treelet_places(100, 1000) == 64 and treelet_places(10, 4) == 16
    assert queue_bytes(1000, 0) == 8 * len(Queue) * 1024
