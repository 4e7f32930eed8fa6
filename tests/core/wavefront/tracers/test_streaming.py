"""Rays that wait for pages come to the hits of rays that find the whole scene in memory, bit for bit, and each is
finished once.
"""

import dataclasses
import gc
import threading

import numpy as np
import pytest
import warp as wp
from benchmarking.ray_order_paging import RayOrderPager

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.transfer import staging_bytes_of
from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.rays import RayKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.pages.stages import TreeletStage, page_stage
from raybatch_addon.core.wavefront.tracers.pages.tracer import StreamingTracer, streaming_bytes_per_path
from tests.core.wavefront.tracers.paged_rays import (
    BUDGET,
    CHECKED,
    LAYOUTS,
    LIVELY,
    ON_CPU,
    ONE,
    PATHS,
    device,
    drain,
    list_of,
    met,
    new_rays,
    paged_of,
    require_right,
    run,
    scene,
    streaming,
    tracer_of,
)
from tests.support.under_test import DEVICE


@pytest.mark.parametrize("shadow", [RayKind.OCCLUSION, RayKind.TRANSPARENT_SHADOW], ids=["any", "closest"])
@pytest.mark.parametrize("slots", [1, 3, 1000])
@pytest.mark.parametrize(
    "nodes_resident, many",
    [(False, False), (True, False), (False, True)],
    ids=["nodes in pages", "nodes there", "treelets"],
)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_hits_are_those_of_the_whole_tree(open_pool, layout, nodes_resident, many, slots, shadow):
    budget = 400_000 if nodes_resident else BUDGET
    paged = paged_of(layout, budget, nodes_resident, many)
    assert len(paged.pages) > 3
    pool = open_pool(paged, min(slots, len(paged.pages)))
    assert pool.slot_count == min(slots, len(paged.pages))
    rays = new_rays()
    tracer = tracer_of(pool, rays, shadow, capacity=700)
    run(tracer, shadow)
    require_right(rays, layout, shadow == RayKind.OCCLUSION)
    totals = tracer.totals()
    assert totals.rays == totals.finished == 2 * PATHS
    assert totals.pages_loaded - totals.pages_evicted <= pool.slot_count
    assert (
        totals.bytes_copied >= totals.pages_loaded * 4096 and totals.treelet_visits > PATHS and totals.rays_queued > 0
    )
    assert paged.resident_bytes < totals.resident_peak <= paged.resident_bytes + pool.slot_count * pool.slot_bytes
    if slots == 1000:
        assert totals.pages_loaded <= len(paged.pages) and totals.pages_evicted == 0
    tracer.close()


@pytest.mark.parametrize("slots", [1, 3, 1000])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_wait_at_the_treelets_of_pages_that_are_there(open_pool, layout, slots):
    settings = RenderSettings(debug_checks="ON", treelet_tier_bytes=1)
    paged = paged_of(layout, many=True)
    totals = []
    for each in (CHECKED, settings):
        rays = new_rays()
        tracer = tracer_of(open_pool(paged, min(slots, len(paged.pages))), rays, settings=each)
        run(tracer, RayKind.OCCLUSION)
        require_right(rays, layout, True)
        totals.append(tracer.totals())
        tracer.close()
    plain, tiers = totals
    assert tiers.rays_queued >= tiers.treelet_visits > plain.rays_queued
    assert tiers.finished == plain.finished == 2 * PATHS


def test_batches_are_put_in_the_order_of_treelets():
    seen = []

    class Noted:
        kernels = ()

        def launch(self, tree, treelets, rays, progress, batch, any_first, counts):
            seen.append((batch.slots.numpy()[:5].tolist(), batch.locations.numpy()[:5].tolist()))

    locations = np.array([7, -2, 3, 7, 3, 1, 0], np.int32)  # the last two are none of the batch's
    batch = list_of(np.arange(7))
    batch = dataclasses.replace(batch, locations=wp.array(locations, dtype=int, device=DEVICE))
    batch.count.assign(np.array([5], np.int32))
    TreeletStage(Noted(), Noted()).launch(None, None, None, None, batch, 0, None)
    assert seen == 2 * [([1, 2, 4, 0, 3], [-2, 3, 3, 7, 7])]
    assert batch.locations.numpy()[5:].tolist() == [1, 0]


def test_memory_for_the_order_of_treelets():
    one, two = (streaming_bytes_per_path(RenderSettings(treelet_tier_bytes=size), 1 << 26, True, 6) for size in (0, 1))
    assert one < two <= one + 2


@pytest.mark.parametrize("slots", [1, 3])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("layout, encoded", [*((layout, False) for layout in LAYOUTS), (Layout.QUANTISED, True)])
def test_from_host_memory_and_from_a_file(open_pool, layout, encoded, store, slots, tmp_path):
    made, flat = scene()
    paged = build_paged_scene(
        flat,
        made.instances.visibility,
        layout,
        device(),
        BUDGET,
        store,
        tmp_path,
        nodes_resident=False,
        encoded=encoded,
    )
    assert paged.encoded == encoded and (paged.pages[0].byte_count < paged.pages[0].device_bytes) == encoded
    pool = open_pool(paged, slots, staging_bytes_of(paged, slots, device()))
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    run(tracer)
    require_right(rays, layout)
    tracer.close()


@pytest.mark.parametrize("store", ["HOST", "DISK"])
@pytest.mark.parametrize("shadow", [RayKind.OCCLUSION, RayKind.TRANSPARENT_SHADOW], ids=["any", "closest"])
@pytest.mark.parametrize("many", [False, True], ids=["one treelet a chunk", "treelets"])
@pytest.mark.parametrize(
    "layout, encoded, on_device",
    [*((layout, False, None) for layout in LAYOUTS), (Layout.QUANTISED, True, False), (Layout.QUANTISED, True, True)],
)
@pytest.mark.parametrize("name", LIVELY)
def test_segments_and_things_that_move(open_pool, name, layout, encoded, on_device, many, shadow, store, tmp_path):
    more = {"encoded": encoded, "on_device": on_device, "store": store, "folder": tmp_path}
    paged = paged_of(layout, 500_000, many, many, name, **more)
    assert len(paged.pages) > 5
    deform = paged.deform.numpy()
    assert (len(np.unique(deform)) > 2 and (deform == 0).any()) == (name == "living")
    pool = open_pool(paged, 3, staging_bytes_of(paged, 3, device()))
    rays = new_rays(time=name == "living")
    tracer = tracer_of(pool, rays, shadow, capacity=900, **met(name))
    run(tracer, shadow)
    require_right(rays, layout, shadow == RayKind.OCCLUSION, name=name)
    assert tracer.totals().pages_loaded > 5
    tracer.close()


@ON_CPU
@pytest.mark.parametrize("slots", [1, 2, 5])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_workers_share_the_pool(open_pool, layout, slots):
    paged = paged_of(layout)
    pool = open_pool(paged, slots)
    page_stage(layout, False, CHECKED)  # compiled before threads start
    warm = tracer_of(pool, new_rays())
    run(warm)
    warm.close()
    results, errors = {}, []

    def work(seed: int) -> None:
        try:
            rays = new_rays(seed=seed)
            tracer = tracer_of(pool, rays, capacity=1500)
            run(tracer)
            results[seed] = rays, tracer.totals()
            tracer.close()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (3, 4, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not errors and len(results) == 3
    for seed, (rays, totals) in results.items():
        require_right(rays, layout, seed=seed)
        assert totals.rays == totals.finished == 2 * PATHS


@ON_CPU
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_control_comes_to_the_same_hits(open_pool, layout):
    paged = paged_of(layout)
    for slots in (1, 4, 1000):
        pool = open_pool(paged, slots)
        rays = new_rays()
        pager = tracer_of(pool, rays, kind=RayOrderPager)
        run(pager)
        require_right(rays, layout)
        totals = pager.totals()
        assert totals.rays == totals.finished == 2 * PATHS
        if slots == 1000:
            assert totals.pages_loaded <= len(paged.pages)


@ON_CPU
def test_streaming_copies_less_than_the_control(open_pool):
    """Rays in no order, a pool of three pages."""
    paged = paged_of(ONE)
    copied = {}
    for kind in (StreamingTracer, RayOrderPager):
        pool = open_pool(paged, 3)
        tracer = tracer_of(
            pool, new_rays(), settings=RenderSettings(), kind=kind, **({"window": 64} if kind is RayOrderPager else {})
        )
        run(tracer)
        copied[kind] = tracer.totals().bytes_copied
    assert 3 * copied[StreamingTracer] < copied[RayOrderPager]


def test_given_up_rays_leave_nothing_behind(open_pool):
    pool, _, given_up = streaming(open_pool, 2)
    given_up.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    given_up.advance()
    assert pool.facts().waiting.sum() > 0
    del given_up
    gc.collect()
    assert pool.facts().waiting.sum() == 0
    rays = new_rays()
    tracer = tracer_of(pool, rays)
    run(tracer)
    require_right(rays)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_triangles_that_are_split_among_pages_act_once(open_pool, layout):
    made, flat = scene()
    paged = build_paged_scene(
        flat,
        made.instances.visibility,
        layout,
        device(),
        BUDGET,
        nodes_resident=False,
        spatial_splits=True,
        encoded=layout is Layout.QUANTISED,
    )
    pool = open_pool(paged, 3)
    rays = new_rays()
    run(tracer_of(pool, rays))
    require_right(rays, layout)


def test_an_advance_is_cut_short_by_the_end_of_the_render(open_pool):
    """A step each, and in the end every ray is finished all the same."""
    _, rays, tracer = streaming(open_pool, 2)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.submit(RayKind.OCCLUSION, list_of(np.arange(PATHS, 2 * PATHS)))
    turns = 0
    while tracer.totals().finished < 2 * PATHS:
        before = tracer.totals().steps
        tracer.advance(lambda: True)
        assert tracer.totals().steps - before <= 1
        tracer.take_finished()
        turns += 1
        assert turns < 10_000
    require_right(rays)


def test_rays_can_be_forgotten(open_pool):
    """Rays are forgotten when a tile is given up: some are done, some wait, and some came in last."""
    pool, rays, tracer = streaming(open_pool, 2)
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    tracer.advance()
    tracer.submit(RayKind.OCCLUSION, list_of(np.arange(PATHS, PATHS + 50)))
    tracer.forget()
    assert tracer.take_finished() == [] and pool.facts().waiting.sum() == 0
    assert (tracer.totals().rays, tracer.totals().finished) == (PATHS + 50, 0)
    run(tracer)
    require_right(rays)
    assert (tracer.totals().rays, tracer.totals().finished) == (3 * PATHS + 50, 2 * PATHS)


def test_one_ray_at_a_time(open_pool):
    _, _, tracer = streaming(open_pool, 1, capacity=1)
    finished: dict = {}
    for slot in (0, 1, PATHS + 1, 2):
        tracer.submit(RayKind.CLOSEST if slot < PATHS else RayKind.OCCLUSION, list_of([slot]))
        drain(tracer, finished)
    assert list(finished.values()) == [1] * 4


def test_debug_checks_find_a_ray_that_comes_in_twice(open_pool):
    _, _, tracer = streaming(open_pool, 1)
    with pytest.raises(AssertionError, match="twice at once"):
        tracer.submit(RayKind.CLOSEST, list_of([4, 4]))
    tracer.submit(RayKind.CLOSEST, list_of(np.arange(PATHS)))
    with pytest.raises(AssertionError, match="under way already, the first in slot 7"):
        tracer.submit(RayKind.CLOSEST, list_of([7]))


def test_nothing_to_do(open_pool):
    _, _, tracer = streaming(open_pool, 1)
    tracer.advance()
    assert tracer.take_finished() == []


@pytest.mark.parametrize("layout", LAYOUTS)
def test_counters_count_every_visit(open_pool, layout):
    paged = paged_of(layout)
    pool = open_pool(paged, 2)
    rays = new_rays()
    counts = TraceCounts()
    for name in ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued"):
        setattr(counts, name, wp.full(2 * PATHS, 77, dtype=int, device=DEVICE))
    counts.lanes = wp.zeros(6, dtype=wp.int64, device=DEVICE)
    tracer = tracer_of(pool, rays, counts=counts)
    run(tracer)
    totals = tracer.totals()
    assert counts.treelet_visits.numpy().sum() == totals.treelet_visits
    assert counts.queued.numpy().sum() == totals.rays_queued
    assert 0 < totals.wait_max <= totals.steps
