"""Treelets that are in large ones: rays find the hits of the unbatched tracer, and wait at large treelets first."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.cpu_visit import boxes_visit_source
from raybatch_addon.core.bvh.traverse.cuda_visit import quantised_visit_source
from raybatch_addon.core.bvh.traverse.options import VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.rays import RayKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.buckets.assigned.every import Every
from raybatch_addon.core.wavefront.tracers.buckets.assigned.fullest import Fullest
from raybatch_addon.core.wavefront.tracers.buckets.assigned.tiers import TierServer, bucket_large
from raybatch_addon.core.wavefront.tracers.buckets.assigned.within import WithinLarge
from raybatch_addon.core.wavefront.tracers.buckets.policy import Step
from raybatch_addon.core.wavefront.tracers.buckets.tracer import queues_per_ray, visit_stages
from tests.core.wavefront.tracers.test_batching_hits import LAYOUTS, PAIRS, compare, cut_case
from tests.core.wavefront.tracers.wandering import PARALLEL
from tests.support.running.shares import each_of, thorough_but

LARGE = 12_000


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("layout, storage", each_of(3, PAIRS))
@pytest.mark.parametrize("name, kind", [("soup", RayKind.OCCLUSION), ("instances", RayKind.TRANSPARENT_SHADOW)])
@pytest.mark.parametrize("selection", ["MOST_FULL", "ALL", "BALANCED"])
def test_hits_are_those_of_the_unbatched_tracer(name, kind, layout, storage, selection, parallel):
    debug = "ON" if name == "soup" else "OFF"
    settings = {"bucket_selection": selection, "ray_storage": storage, "debug_checks": debug}
    compare(name, layout, kind, parallel, treelet_tier_bytes=LARGE, **settings)


@pytest.mark.parametrize("layout", each_of(1, LAYOUTS))
@pytest.mark.parametrize("name", thorough_but(["living"], ["hairy", "living"]))
def test_segments_and_things_that_move(name, layout):
    compare(name, layout, RayKind.TRANSPARENT_SHADOW, PARALLEL[-1], treelet_tier_bytes=LARGE)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "settings",
    [
        {"queue_size": 1, "queue_count": 1, "bucket_wait_max": 1},
        {"capacity": 32, "shared": False, "queues_per_ray": 3},
        {"rays_few": 10**6},
        {"counters": True, "treelet_prefetch": "ON", "bucket_selection": "LAZY"},
        {"top_level_traversal": "INTERLOCKED", "bucket_selection": "RANDOM"},
        {"single_lane": "ON"},
    ],
    ids=lambda settings: ",".join(map(str, settings)),
)
def test_settings_change_no_hit(settings, layout):
    given = {"treelet_tier_bytes": LARGE, **settings}
    totals = compare("instances", layout, RayKind.OCCLUSION, PARALLEL[-1], **given)
    assert (totals.rays_unbatched > 0) == ("rays_few" in settings)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_large_treelets_hold_treelets_and_are_no_larger_than_asked_for(layout):
    cut = cut_case("instances", layout, LARGE)[1]
    large, held = cut.treelet_large, cut.treelet_bytes
    assert cut.large_count > 3 and set(large[large >= 0]) == set(range(cut.large_count))
    assert np.bincount(large[large >= 0], held[large >= 0]).max() <= LARGE
    of_node = cut.treelets.of_node.numpy()
    there = of_node[of_node >= 0]
    assert sorted(there) == list(range(cut.treelet_count + cut.large_count)), "each has one root"
    assert (np.bincount(large + 1)[1:] > 1).any()


def test_rays_wait_at_large_treelets_too():
    """So they are queued more often than at treelets alone, and visit these as often."""
    one, two = (
        compare("instances", LAYOUTS[0], RayKind.OCCLUSION, PARALLEL[-1], treelet_tier_bytes=size)
        for size in (1, LARGE)  # no large treelet is as small as that
    )
    assert two.rays_queued > one.rays_queued


def test_a_large_treelet_is_served_until_no_ray_waits_in_it():
    policy = WithinLarge(Fullest(), np.array([0, 1, 1, -1, 0, 1, -1]))

    def chosen(*loads):
        return policy.choose(np.array(loads)).tolist()

    assert chosen(9, 9, 9, 0, 0, 0, 2) == [6], "what is in none comes first"
    assert chosen(9, 9, 9, 0, 0, 0, 0) == [1]
    assert chosen(99, 0, 9, 0, 0, 0, 0) == [2]
    assert chosen(99, 0, 0, 9, 0, 9, 0) == [5]
    assert chosen(5, 0, 0, 9, 5, 0, 0) == [0], "most rays wait in the large treelet, in two of its buckets"
    assert WithinLarge(Every(), np.array([0, 1, 1, -1])).choose(np.array([3, 4, 0, 0])).tolist() == [1]


def test_buckets_know_their_large_treelet():
    cut = cut_case("soup", LAYOUTS[0], LARGE)[1]
    large = bucket_large(cut)
    assert len(large) == cut.treelet_count + cut.large_count + 1 and large[-1] == -1
    assert large[cut.treelet_count : -1].tolist() == list(range(cut.large_count))


def test_kernels_without_tiers_are_what_they_were():
    """Only the way through the top level knows of large treelets."""
    for source in (boxes_visit_source, quantised_visit_source):
        for task in VisitTask:
            plain = VisitOptions(task=task, instancing=True)
            assert "tiers" not in source(plain)
        assert "tiers" in source(dataclasses.replace(plain, task=VisitTask.TOP, tiers=True))
    without, tiers = (
        visit_stages(Layout.QUANTISED, True, False, RenderSettings(treelet_tier_bytes=size)) for size in (0, LARGE)
    )
    assert tiers[VisitTask.TREELET].kernels == without[VisitTask.TREELET].kernels
    assert tiers[VisitTask.TOP].kernels != without[VisitTask.TOP].kernels
    assert VisitTask.GO_ON not in tiers


def test_a_cache_is_before_tiers_and_tiers_before_several_queues():
    assert queues_per_ray(RenderSettings(queues_per_ray=3, treelet_tier_bytes=1)) == 1
    both = RenderSettings(treelet_tier_bytes=LARGE, treelet_cache=4000)
    assert VisitTask.GO_ON in visit_stages(Layout.QUANTISED, True, False, both)


def test_queues_of_large_treelets_go_through_the_top_level():
    """Treelets first: a large treelet may send rays to their queues."""
    done = []

    class Noted(TierServer):
        def __init__(self):
            self._small, self._large = range(0, 8, 2), range(8, 12, 2)

        def _take(self, queues, amount):
            return list(queues)

        def _do(self, task, batch):
            done.append((task, batch))

    Noted().serve(Step.TREELET, [2, 6, 8], 9)
    Noted().serve(Step.TREELET, [10], 9)
    Noted().serve(Step.TOP, [1, 13], 9)
    assert done == [(VisitTask.TREELET, [2, 6]), (VisitTask.TOP, [8]), (VisitTask.TOP, [10]), (VisitTask.TOP, [1, 13])]
