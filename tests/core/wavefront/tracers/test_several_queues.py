"""Rays that wait at several treelets at a time find the hits of the unbatched tracer."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.tree import TopProgress, Tree
from raybatch_addon.core.rays import DeviceRayList, RayKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_progress, allocate_rays
from raybatch_addon.core.wavefront.tracers.buckets.blocks import PLACES_MAX
from raybatch_addon.core.wavefront.tracers.buckets.several.kernels import (
    PARKED,
    Copies,
    enter_copies_kernel,
    gather_copies_kernel,
    leave_copies_kernel,
)
from raybatch_addon.core.wavefront.tracers.buckets.tracer import batching_bytes_per_path, batching_kernels, copies_of
from tests.core.wavefront.tracers.test_batching_hits import LAYOUTS, compare
from tests.core.wavefront.tracers.wandering import PARALLEL
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name, kind", [("soup", RayKind.TRANSPARENT_SHADOW), ("instances", RayKind.OCCLUSION)])
@pytest.mark.parametrize("selection, width", [("MOST_FULL", 2), ("ALL", 8), ("BALANCED", 3)])
def test_hits_are_those_of_the_unbatched_tracer(name, kind, layout, selection, width, parallel):
    debug = "ON" if name == "soup" else "OFF"
    settings = {"bucket_selection": selection, "queues_per_ray": width, "debug_checks": debug}
    compare(name, layout, kind, parallel, counters=width == 3, **settings)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "settings",
    [
        {"queue_size": 1, "queue_count": 1},
        {"capacity": 32, "shared": False},
        {"rays_few": 10**6},
        {"rays_few": 30, "bucket_selection": "NEXT"},
        {"ray_storage": "DIRECT", "treelet_prefetch": "ON"},
    ],
    ids=lambda settings: ",".join(map(str, settings)),
)
def test_settings_change_no_hit(settings, layout):
    totals = compare("instances", layout, RayKind.OCCLUSION, PARALLEL[-1], queues_per_ray=4, **settings)
    assert (totals.rays_unbatched > 0) == ("rays_few" in settings)


@pytest.mark.parametrize("layout", each_of(1, LAYOUTS))
@pytest.mark.parametrize("name", ["hairy", "living"])
def test_segments_and_things_that_move(name, layout):
    compare(name, layout, RayKind.TRANSPARENT_SHADOW, PARALLEL[-1], queues_per_ray=3, bucket_selection="ALL")


def test_rays_come_to_their_end_in_fewer_sweeps():
    steps = [
        compare("soup", LAYOUTS[0], RayKind.OCCLUSION, PARALLEL[-1], queues_per_ray=width, bucket_selection="ALL").steps
        for width in (1, 2, 8)
    ]
    assert steps[0] > steps[1] > steps[2]


def test_what_one_copy_met_counts_for_others():
    """Where the fullest is served first, others know of nearer hits; where all are served at once, none does."""
    one_by_one, at_once = (
        compare(
            "soup", LAYOUTS[0], RayKind.OCCLUSION, PARALLEL[-1], queues_per_ray=8, bucket_selection=selection
        ).treelet_visits
        for selection in ("MOST_FULL", "ALL")
    )
    assert one_by_one < at_once


def test_rays_that_pass_through_a_cache_wait_at_one_treelet():
    totals = [
        compare("instances", LAYOUTS[0], RayKind.OCCLUSION, PARALLEL[-1], queues_per_ray=width, treelet_cache=4000)
        for width in (1, 5)
    ]
    assert totals[0].rays_queued == totals[1].rays_queued and totals[0].steps == totals[1].steps


def three_copies(hits):
    """A ray of three copies that were sent to treelets 10, 11 and 12, and have met `hits`: (t, entry, face) or None."""
    device = wp.get_device(DEVICE)
    tree, copies, progress = Tree(), Copies(), TopProgress()
    # of entry 0 instance 5, of entry 1 instance 4, of entry 2 two baked ones
    tree.entry_instance = wp.array([5, 4, -1], dtype=int, device=device)
    tree.merged_first = wp.array([0, 0, 0, 2], dtype=int, device=device)
    tree.merged_instance = wp.array([3, 6], dtype=int, device=device)
    tree.merged_triangle_first = wp.array([0, 10], dtype=int, device=device)
    copies.width, copies.any_first = 3, 2**31 - 1
    for name, value in (("waiting", [3]), ("used", [3]), ("ended", [0]), ("last", [7]), ("at", [10, 11, 12])):
        setattr(copies, name, wp.array(value, dtype=int, device=device))
    copies.best = wp.array([9.0], dtype=float, device=device)
    home = allocate_rays(1, device)
    rays = allocate_rays(3, device, RayNeeds(limits=False))
    rays.hit_t.assign(np.array([hit[0] if hit else 9 for hit in hits], np.float32))
    rays.hit_instance.assign(np.array([hit[1] if hit else -1 for hit in hits], np.int32))
    rays.hit_primitive.assign(np.array([hit[2] if hit else -1 for hit in hits], np.int32))
    rays.hit_uv.assign(np.arange(6, dtype=np.float32).reshape(3, 2))
    progress = allocate_progress(3, 1, True, device)
    progress.trail.assign(np.array([[20, 21, 22]], np.uint32))
    progress.entry.assign(np.array([30, 31, 32], np.int32))
    return home, tree, copies, rays, progress


def come_back(state, places):
    home, tree, copies, rays, progress = state
    batch = DeviceRayList()
    batch.slots = wp.array(places, dtype=int, device=DEVICE)
    batch.locations = wp.array([10 + place for place in places], dtype=int, device=DEVICE)
    batch.count = wp.array([len(places)], dtype=int, device=DEVICE)
    wp.launch(enter_copies_kernel, len(places), [copies, rays, batch], device=DEVICE)
    wp.launch(leave_copies_kernel, len(places), [copies, rays, batch], device=DEVICE)
    wp.launch(gather_copies_kernel, len(places), [home, tree, copies, rays, progress, batch], device=DEVICE)
    return batch.slots.numpy().tolist(), batch.locations.numpy().tolist()


@pytest.mark.parametrize(
    "hits, expected",
    [
        ([(2, 0, 7), (1, 0, 9), None], 1),  # the nearest
        ([(2, 0, 7), (2, 0, 6), (2, 0, 8)], 1),  # of equals the lower primitive
        ([(2, 0, 1), (2, 1, 9), None], 1),  # the lower instance
        ([(2, 1, 1), (2, 2, 9), (2, 2, 10)], 1),  # of baked ones too
        ([(2, 1, 1), (2, 2, 10), None], 0),
        ([None, None, None], 0),
    ],
)
@pytest.mark.parametrize("order", [[[0, 1, 2]], [[2], [1, 0]], [[1], [2], [0]]])
def test_ties_are_settled_as_by_one_after_another(hits, expected, order):
    state = three_copies(hits)
    for places in order[:-1]:
        assert come_back(state, places)[1] == [PARKED] * len(places)
    places, locations = come_back(state, order[-1])
    assert places[-1] == 0 and locations[-1] == 12, "the first copy goes on behind the last treelet"
    assert locations[:-1] == [PARKED] * (len(locations) - 1)
    rays, progress = state[3:]
    t, entry, face = hits[expected] or (9, -1, -1)
    assert (rays.hit_t.numpy()[0], rays.hit_instance.numpy()[0], rays.hit_primitive.numpy()[0]) == (t, entry, face)
    if hits[expected]:
        assert rays.hit_uv.numpy()[0].tolist() == [2 * expected, 2 * expected + 1]
    assert progress.trail.numpy()[0, 0] == 22 and progress.entry.numpy()[0] == 32


def test_a_hit_at_the_same_distance_is_still_looked_for():
    state = three_copies([(2, 0, 7), None, (3, 0, 1)])
    come_back(state, [0])
    come_back(state, [1, 2])
    limits = state[3].hit_t.numpy()[1:]
    assert (limits > 2).all() and (limits < 2.000001).all()


def test_places_are_numbered_by_31_bits():
    assert copies_of(8, 1000) == 8
    assert copies_of(8, 2**28) * 2**28 <= PLACES_MAX
    assert copies_of(8, 2**30) == 1


def test_memory_and_kernels_of_copies():
    several = RenderSettings(queues_per_ray=4)
    one, four = (batching_bytes_per_path(each, True, True, 6, True) for each in (RenderSettings(), several))
    assert four > 4 * one
    assert batching_bytes_per_path(RenderSettings(queues_per_ray=4, treelet_cache=1), True, True, 6, True) == one
    device = wp.get_device(DEVICE)
    assert gather_copies_kernel in batching_kernels(LAYOUTS[0], True, False, several, device)
    assert gather_copies_kernel not in batching_kernels(LAYOUTS[0], True, False, RenderSettings(), device)
