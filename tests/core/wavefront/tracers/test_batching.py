"""The tracer that batches: every ray is finished exactly once with the hit of the unbatched tracer, whatever the
settings.
"""

import numpy as np
import pytest

from raybatch_addon.core.rays import RayKind
from raybatch_addon.core.wavefront.tracers.buckets.blocks import STEP
from tests.core.wavefront.tracers.queue_state import set_step
from tests.core.wavefront.tracers.wandering import PARALLEL, SELECTIONS, drain, slot_list, wandering
from tests.support.under_test import DEVICE


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
@pytest.mark.parametrize(
    "sizes", [(1, 0, 0), (20, 0, 0), (20, 1, 1), (1, 1, 1), (20, 4, 6), (10_000, 0, 0), (10_000, 8, 3)]
)
def test_every_ray_is_finished_once(parallel, selection, sizes):
    treelets, queue_size, queue_count = sizes
    paths = 300
    few = 0 if treelets < 100 else 2
    tracer, visits = wandering(
        treelets,
        paths,
        parallel,
        few,
        seed=3,
        bucket_selection=selection,
        queue_size=queue_size,
        queue_count=queue_count,
        debug_checks="ON" if treelets == 20 else "OFF",
    )
    closest, shadow = np.random.default_rng(0).permutation(paths)[:250], paths + np.arange(0, 300, 2)
    tracer.submit(RayKind.CLOSEST, slot_list(closest))
    tracer.submit(RayKind.OCCLUSION, slot_list(shadow))
    back = drain(tracer)
    assert sorted(back[RayKind.CLOSEST]) == sorted(closest.tolist())
    assert sorted(back[RayKind.OCCLUSION]) == shadow.tolist()
    begun, visited, finished = visits.numpy()
    alive = np.isin(np.arange(2 * paths), [*closest, *shadow])
    np.testing.assert_array_equal(begun, alive)
    np.testing.assert_array_equal(finished, alive)
    np.testing.assert_array_equal(visited[alive], np.arange(2 * paths)[alive] % 7)
    totals = tracer.totals()
    assert totals.rays == totals.finished == 400
    assert totals.steps > 0
    assert (totals.blocks_short > 0) == (queue_count > 0)
    if not few and selection != "ALL":
        assert totals.rays_queued == 400 + 2 * visited.sum()  # to begin, before each visit and behind it
        assert totals.rays_unbatched == 0


@pytest.mark.parametrize("parallel", PARALLEL)
def test_rays_come_in_and_go_out_at_any_time(parallel):
    tracer, _visits = wandering(15, 200, parallel, capacity=64, debug_checks="ON", queue_size=8)
    rng = np.random.default_rng(4)
    free, alive, sent, back = set(range(400)), set(), 0, 0
    for turn in range(60):
        new = rng.permutation(sorted(free))[: rng.integers(0, 150)] if turn < 40 else np.zeros(0, int)
        for kind, chosen in ((RayKind.CLOSEST, new[new < 200]), (RayKind.OCCLUSION, new[new >= 200])):
            if len(chosen):
                tracer.submit(kind, slot_list(chosen))
        free -= set(new.tolist())
        alive |= set(new.tolist())
        sent += len(new)
        tracer.advance()
        finished = tracer.take_finished()
        assert finished or not alive
        for kind, listed in finished:
            slots = listed.slots.numpy()[: listed.bound].tolist()
            assert listed.bound == int(listed.count.numpy()[0])
            assert alive.issuperset(slots)
            assert all((slot < 200) == (kind == RayKind.CLOSEST) for slot in slots)
            alive -= set(slots)
            free |= set(slots)
            back += len(slots)
        totals = tracer.totals()
        assert (totals.rays, totals.finished) == (sent, back)
    assert sent > 1000
    assert not alive


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("sizes", [(0, 0), (4, 5)])
def test_rays_can_be_forgotten(parallel, sizes):
    """Rays are forgotten when a tile is given up."""
    tracer, visits = wandering(30, 200, parallel, debug_checks="ON", queue_size=sizes[0], queue_count=sizes[1])
    for turn in range(3):
        visits.zero_()
        tracer.submit(RayKind.CLOSEST, slot_list(np.arange(200)))
        tracer.advance()
        if turn < 2:
            tracer.forget()
            assert tracer.take_finished() == []
    assert len(drain(tracer)[RayKind.CLOSEST]) == 200
    totals = tracer.totals()
    assert (totals.rays, totals.finished) == (600, 200)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
def test_an_advance_is_cut_short_by_the_end_of_the_render(parallel, selection):
    """A step each, and in the end every ray is finished all the same."""
    tracer, visits = wandering(50, 500, parallel, bucket_selection=selection)
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(500)))
    turns = []
    while tracer.totals().finished < 500:
        before = tracer.totals().steps
        tracer.advance(lambda: True)
        turns.append(tracer.totals().steps - before)
        tracer.take_finished()
        assert len(turns) < 10_000
    if DEVICE == "cpu" and not parallel:
        assert max(turns) == 1
    np.testing.assert_array_equal(visits.numpy()[2, :500], 1)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("selection", SELECTIONS)
def test_a_tree_without_treelets(parallel, selection):
    tracer, _visits = wandering(
        0, 100, parallel, bucket_selection=selection, debug_checks="ON" if selection == "NEXT" else "OFF"
    )
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(0, 100, 7)))
    assert len(drain(tracer)[RayKind.CLOSEST]) == 15


def test_few_rays_go_on_unbatched():
    tracer, visits = wandering(50, 100, PARALLEL[0], rays_few=20, bucket_selection="MOST_FULL")
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(100)))
    drain(tracer)
    totals = tracer.totals()
    assert 50 < totals.rays_unbatched < 100
    assert totals.steps == 2
    np.testing.assert_array_equal(visits.numpy()[2, :100], 1)


@pytest.mark.parametrize("parallel", PARALLEL)
def test_more_steps_are_counted_than_32_bits_hold(parallel):
    tracer, _ = wandering(50, 100, parallel, bucket_selection="MOST_FULL")
    set_step(tracer._queues, 2**31 - 3)
    tracer.submit(RayKind.CLOSEST, slot_list(np.arange(100)))
    drain(tracer)
    assert tracer._queues.fetch_state()[STEP] < 0
    assert 2**31 < tracer.totals().steps < 2**31 + 10_000


def test_waits_and_occupancy_are_reported():
    bounded, _ = wandering(40, 500, PARALLEL[0], bucket_selection="MOST_FULL", bucket_wait_max=30)
    free, _ = wandering(40, 500, PARALLEL[0], bucket_selection="MOST_FULL")
    waits = []
    for tracer in (bounded, free):
        for _ in range(40):
            tracer.submit(RayKind.CLOSEST, slot_list(np.arange(500)))
            drain(tracer)
        waits.append(tracer.totals().wait_max)
        points = tracer.totals().occupancy
        assert 10 < len(points) <= 256
        assert points == sorted(points)
        assert len(points) > 100 or tracer.totals().steps < 3000
        assert max(waiting for _, waiting in points) == 500
    assert 30 <= waits[0] <= 30 + 82
