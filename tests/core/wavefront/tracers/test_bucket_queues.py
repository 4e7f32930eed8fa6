"""Queues of waiting rays: every ray is in one place, whatever the sizes; both ways of keeping them, on every device."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.tree import DONE, NEW
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.wavefront.tracers.buckets.blocks import pool_size
from raybatch_addon.core.wavefront.tracers.buckets.queues import BucketQueues, queue_rule
from raybatch_addon.core.wavefront.tracers.buckets.scan import Scan
from tests.core.wavefront.tracers.queue_state import free_block_count, set_step

wp.init()
WAYS = [("cpu", False), ("cpu", True)] + [(device.alias, True) for device in wp.get_cuda_devices()]
# queues, queue_size, queue_count, rays
SIZES = [
    (7, 0, 0, 300),
    (7, 4, 0, 300),
    (1, 1, 1, 50),
    (5, 1, 1, 60),
    (40, 8, 3, 200),
    (10_000, 0, 0, 500),
    (10_000, 16, 5, 300),
    (3, 1024, 0, 10),
]


@pytest.fixture(params=WAYS, ids=lambda way: f"{way[0]}-{'parallel' if way[1] else 'sequential'}")
def way(request):
    return {"device": wp.get_device(request.param[0]), "parallel": request.param[1]}


def batch_of(device, slots, where, bound=None) -> RayList:
    """`bound` larger than the count: the arrays go on with what must not be looked at."""
    bound = len(slots) if bound is None else bound
    garbage = np.full(bound - len(slots), 1 << 30, np.int32)
    slots, where = (np.concatenate([np.asarray(each, np.int32), garbage]) for each in (slots, where))
    count = wp.array([bound - len(garbage)], dtype=int, device=device)
    return RayList(wp.array(slots, dtype=int, device=device), count, bound, wp.array(where, dtype=int, device=device))


def rays_of(batch) -> tuple[np.ndarray, np.ndarray]:
    count = int(batch.count.numpy()[0])
    return batch.slots.numpy()[:count], batch.locations.numpy()[:count]


@pytest.mark.parametrize("sizes", SIZES)
def test_every_ray_is_in_one_place(way, sizes):
    queue_total, queue_size, queue_count, ray_count = sizes
    rng = np.random.default_rng(queue_total + queue_size)
    queues = BucketQueues(
        queue_total, queue_size, queue_count, ray_count, debug=True, capacity=max(64, queue_size), **way
    )
    waits = {}
    outside = set(range(ray_count))
    for _ in range(25):
        slots = rng.permutation(sorted(outside))[: rng.integers(0, len(outside) + 1)]
        skewed = np.minimum(rng.geometric(0.2, len(slots)) - 1, queue_total - 1)
        where = skewed if rng.random() < 0.5 else rng.integers(0, queue_total, len(slots))
        queues.put(batch_of(way["device"], slots, where, len(slots) + int(rng.integers(0, 3))))
        waits.update(zip(slots.tolist(), where.tolist()))
        outside -= set(slots.tolist())
        counts = np.bincount(list(waits.values()), minlength=queue_total) if waits else np.zeros(queue_total)
        np.testing.assert_array_equal(queues.fetch_counts(), counts)
        assert queues.waiting == len(waits)
        chosen = rng.choice(queue_total, min(queue_total, int(rng.integers(1, 4))), replace=False)
        taken, places = rays_of(queues.take(chosen.tolist()))
        assert all(waits.pop(slot) == queue for slot, queue in zip(taken.tolist(), places.tolist()))
        wanted = int(counts[chosen].sum())
        assert len(taken) == wanted if wanted <= queues.capacity else 0 < len(taken) <= queues.capacity
        outside |= set(taken.tolist())
    while waits:
        taken, places = rays_of(queues.take(None))
        assert len(taken)
        assert all(waits.pop(slot) == queue for slot, queue in zip(taken.tolist(), places.tolist()))
    assert queues.waiting == queues.overflowing == 0
    assert free_block_count(queues) == queues.size.block_count


def test_a_queue_keeps_its_order(way):
    queues = BucketQueues(3, 4, 0, 100, debug=True, **way)
    slots = np.random.default_rng(1).permutation(90)
    for first in range(0, 90, 30):
        queues.put(batch_of(way["device"], slots[first : first + 30], slots[first : first + 30] % 3))
    for queue in (1, 0, 2):
        taken, _ = rays_of(queues.take([queue]))
        np.testing.assert_array_equal(taken, slots[slots % 3 == queue])


def test_a_batch_may_be_larger_than_what_is_taken_at_once(way):
    queues = BucketQueues(4, 8, 0, 1000, debug=True, capacity=32, **way)
    queues.put(batch_of(way["device"], np.arange(1000), np.arange(1000) % 4, 1100))
    seen = []
    for _ in range(1000):
        taken, places = rays_of(queues.take(range(1, 4, 2)))
        if not len(taken):
            break
        assert len(taken) <= 32
        assert set(places.tolist()) <= {1, 3}
        seen += taken.tolist()
    assert sorted(seen) == [slot for slot in range(1000) if slot % 2]
    assert queues.waiting == 500


def test_rules_take_queues_from_treelets(way):
    queues = BucketQueues(8, 2, 0, 10, debug=True, **way)
    entry, exit_ = queue_rule(2, 0, done=6, new=7), queue_rule(2, 1, done=-1, new=7)
    queues.put(batch_of(way["device"], [0, 1, 2, 3], [NEW, DONE, 2, 0]), entry)
    queues.put(batch_of(way["device"], [4, 5, 6], [1, DONE, 2]), exit_)  # ray 5 leaves
    np.testing.assert_array_equal(queues.fetch_counts(), [1, 0, 0, 1, 1, 1, 1, 1])
    slots, where = rays_of(queues.take(None, entry))
    assert dict(zip(slots.tolist(), where.tolist())) == {3: 0, 4: 1, 2: 2, 6: 2, 1: DONE, 0: NEW}


def test_places_say_where_rays_lie(way):
    device = way["device"]
    queues = BucketQueues(5, 2, 3, 20, debug=True, **way)
    put, taken = wp.zeros(20, dtype=int, device=device), wp.zeros(queues.capacity, dtype=int, device=device)
    slots = np.random.default_rng(2).permutation(20)
    where = np.where(slots == 3, DONE, slots % 5)
    queues.put(batch_of(device, slots, where), pool_index=put)
    lies = dict(zip(slots.tolist(), put.numpy().tolist()))
    assert lies.pop(3) == -1
    assert len(set(lies.values())) == 19
    assert max(lies.values()) < queues.size.entry_count
    assert queues.totals()["blocks_short"] == 1  # 3 blocks of 2
    assert queues.overflowing == 13
    batch = queues.take(None, pool_index=taken)
    found = dict(zip(rays_of(batch)[0].tolist(), taken.numpy().tolist()))
    assert found == lies


def test_waiting_and_shortage_are_counted(way):
    device = way["device"]
    queues = BucketQueues(4, 2, 2, 12, debug=True, **way)
    set_step(queues, 3)
    queues.put(batch_of(device, [0, 1], [1, 1]))
    set_step(queues, 5)
    queues.put(batch_of(device, [2], [1]))
    queues.put(batch_of(device, [3], [0]))  # no block is left
    set_step(queues, 10)
    queues.take([0])
    assert queues.totals() == {"rays_queued": 4, "blocks_peak": 2, "blocks_short": 1, "wait_max": 5, "block_count": 2}
    queues.take([1])
    assert queues.totals()["wait_max"] == 7


def test_more_puts_are_counted_than_32_bits_hold(way):
    queues = BucketQueues(2, 4, 0, 10, **way)
    queues.blocks.put.fill_(2**31 - 1)
    queues.put(batch_of(way["device"], np.arange(10), np.arange(10) % 2))
    assert queues.totals()["rays_queued"] == 2**31 + 9


def test_checks_find_what_is_wrong(way):
    device = way["device"]
    queues = BucketQueues(4, 2, 0, 12, debug=True, **way)
    with pytest.raises(AssertionError, match="put twice"):
        queues.put(batch_of(device, [1, 1], [0, 2]))
    queues = BucketQueues(4, 2, 0, 12, debug=True, **way)
    queues.put(batch_of(device, [1, 2], [0, 2]))
    with pytest.raises(AssertionError, match=r"rays \[2\] were put, but wait in queues \[2\]"):
        queues.put(batch_of(device, [2], [1]))
    for name, message in (("counts", "count"), ("owner", "belong"), ("in_blocks", "block")):
        queues = BucketQueues(4, 2, 0, 12, debug=True, **way)
        queues.put(batch_of(device, [1, 2], [0, 2]))
        array = getattr(queues.blocks, name)
        values = array.numpy()
        values[1] += 3
        array.assign(values)
        with pytest.raises(AssertionError, match=message):
            queues.put(batch_of(device, [5], [3]))


@pytest.mark.parametrize("queue_total", [1, 2, 200, 20_000, 100_000])
@pytest.mark.parametrize("slot_count", [1, 7, 1000, 65_536])
def test_sizes_have_a_place_for_every_ray(queue_total, slot_count):
    chosen = pool_size(queue_total, 0, 0, slot_count)
    assert chosen.overflow == 0
    assert chosen.entry_count <= 2 * slot_count
    for queue_size in (1, 3, 64, 1 << 20):
        for queue_count in (0, 1, 5, 1 << 20):
            size = pool_size(queue_total, queue_size, queue_count, slot_count)
            assert size.queue_size == min(queue_size, slot_count)
            assert size.block_count <= (queue_count or size.block_count)
            assert size.entry_count <= 3 * slot_count or queue_count
    assert pool_size(queue_total, 0, 3, slot_count).block_count <= 3


def test_places_can_be_numbered_whatever_is_asked_for():
    """The most that settings allow, with a shadow ray for every path."""
    for queue_size, queue_count in ((2**24, 127), (2**23, 255), (7, 2**28), (2**24, 0), (0, 2**28), (1, 1)):
        size = pool_size(40_002, queue_size, queue_count, 2**29)
        assert 2**29 <= size.entry_count <= 2**31 - 1 and size.block_count > 0, (queue_size, queue_count)


@pytest.mark.parametrize("count", [1, 31, 64, 1000, 70_000])
def test_scan(count):
    for device in {way[0] for way in WAYS}:
        values = np.random.default_rng(count).integers(0, 9, count)
        result = wp.zeros(count + 1, dtype=int, device=device)
        Scan(wp.get_device(device)).launch(wp.array(values, dtype=int, device=device), result)
        np.testing.assert_array_equal(result.numpy(), np.concatenate([[0], np.cumsum(values)]))
