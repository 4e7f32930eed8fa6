"""Rays are taken in the order of their slots, within their limits, and counted as a NumPy twin counts them."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.rays import RayList
from raybatch_addon.core.wavefront.tracers.pages.kernels import CHUNKS_MOST, IDLE, SLOTS_A_TURN
from raybatch_addon.core.wavefront.tracers.pages.rays import WaitingRays, page_batch_capacity, streaming_bytes_per_slot
from tests.support.under_test import DEVICE

NEW, DONE = -2, -1
TREELETS, PAGES = 12, 5
PAGE_OF = np.array([0, 0, 1, 1, 1, 2, 3, 3, 4, 4, 4, 4])


def rays_of(slots: int, shadow_first: int, capacity: int = 0) -> WaitingRays:
    return WaitingRays(
        slots, shadow_first, wp.array(PAGE_OF, dtype=int, device=DEVICE), PAGES, wp.get_device(DEVICE), capacity
    )


def list_of(slots) -> RayList:
    return RayList(
        wp.array(np.asarray(slots, np.int32), device=DEVICE),
        wp.array([len(slots)], dtype=int, device=DEVICE),
        len(slots),
    )


@pytest.mark.parametrize(
    "slots, capacity", [(1, 0), (31, 7), (128, 0), (5000, 0), (5000, 300), (SLOTS_A_TURN * CHUNKS_MOST + 777, 40_000)]
)
def test_against_a_twin(slots, capacity):
    rng = np.random.default_rng(slots)
    shadow_first = slots * 2 // 3
    rays, capacity = rays_of(slots, shadow_first, capacity), capacity or slots
    visits = wp.array([42], dtype=wp.int64, device=DEVICE)
    where = np.full(slots, IDLE)
    number = np.arange(slots)
    for _ in range(6):
        idle = np.flatnonzero(where == IDLE)
        come = rng.permutation(idle)[: int(rng.integers(0, len(idle) + 1))]
        if len(come):
            rays.submit(list_of(come))
            where[come] = NEW
        there = rng.random(TREELETS) < 0.5
        new_most = int(rng.choice([0, 3, slots]))
        batch = rays.take(wp.array(there.astype(np.uint64) * 4096, dtype=wp.uint64, device=DEVICE), new_most, slots)
        waits = number[(where >= 0) & there[np.maximum(where, 0)]][:capacity]
        new = number[where == NEW][: min(new_most, capacity - len(waits))]
        expected = np.concatenate([waits, new])
        count = int(batch.count.numpy()[0])
        assert count == len(expected) <= batch.bound
        assert np.array_equal(batch.slots.numpy()[:count], expected)
        assert np.array_equal(batch.locations.numpy()[:count], where[expected])
        places = rng.integers(DONE, TREELETS, count)
        places[rng.random(count) < 0.3] = DONE
        after = batch.locations.numpy()
        after[:count] = places
        batch.locations.assign(after)
        rays.put(batch)
        where[expected] = places
        counts = rays.count(visits).read()
        rays.check(counts)
        assert (counts.taken, counts.visits, counts.idle) == (count, 42, (where == IDLE).sum())
        done = [number[(where == DONE) & (number < shadow_first)], number[(where == DONE) & (number >= shadow_first)]]
        assert [counts.done_closest, counts.done_shadow] == [len(each) for each in done]
        done[0] = done[0][:capacity]
        done[1] = done[1][: capacity - len(done[0])]
        lists = rays.take_done(counts)
        assert [shadow for shadow, _ in lists] == [shadow for shadow in (False, True) if len(done[shadow])]
        for shadow, listed in lists:
            assert listed.bound == int(listed.count.numpy()[0]) == len(done[shadow])
            assert np.array_equal(listed.slots.numpy()[: listed.bound], done[shadow])
            where[done[shadow]] = IDLE
        rays.check(dataclasses.replace(rays.count(visits).read(), taken=0))


def test_wrong_counts_are_found():
    rays = rays_of(100, 50)
    rays.submit(list_of([3, 60]))
    visits = wp.zeros(1, dtype=wp.int64, device=DEVICE)
    counts = rays.count(visits).read()
    rays.check(counts)
    rays._waiting.location.fill_(IDLE)
    with pytest.raises(AssertionError, match=r"'idle': \(98, "):
        rays.check(counts)
    rays._waiting.location.fill_(TREELETS)
    with pytest.raises(AssertionError, match="treelet 12 of 12"):
        rays.check(counts)


def test_memory_of_a_ray():
    assert page_batch_capacity(10) == 10 and page_batch_capacity(1 << 28) == 1 << 24
    assert streaming_bytes_per_slot(1 << 27) == 4.5
