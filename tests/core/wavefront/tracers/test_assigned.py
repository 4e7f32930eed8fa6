"""Policies that serve several buckets in a step."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.tree import Treelets
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.buckets.assigned.balanced import Balanced
from raybatch_addon.core.wavefront.tracers.buckets.assigned.immediate import RecentTreelets
from raybatch_addon.core.wavefront.tracers.buckets.assigned.lazy import Lazy
from raybatch_addon.core.wavefront.tracers.buckets.assigned.policies import assignment_of
from raybatch_addon.core.wavefront.tracers.buckets.policy import Selection
from raybatch_addon.core.wavefront.tracers.buckets.tracer import few_rays, processor_count


def chosen(policy, *loads) -> list[int]:
    return policy.choose(np.array(loads)).tolist()


def test_a_processor_stays_with_its_bucket_until_it_is_empty():
    policy = Lazy(2)
    assert chosen(policy, 3, 9, 0, 5) == [1, 3]
    assert chosen(policy, 30, 1, 40, 5) == [1, 3], "others are fuller now"
    assert chosen(policy, 30, 0, 40, 5) == [2, 3]
    assert chosen(policy, 30, 0, 0, 0) == [0]
    assert chosen(Lazy(9), 0, 2, 2) == [1, 2]
    assert chosen(Lazy(1), 0, 2, 2) == [1], "of equals the first"


def test_buckets_with_more_rays_than_the_mean_are_served():
    policy = Balanced()
    assert chosen(policy, 1, 9, 0, 5) == [1, 3]
    assert chosen(policy, 4, 0, 4) == [0, 2]
    assert chosen(policy, 0, 0, 1) == [2]


@pytest.mark.parametrize("selection", Selection)
def test_some_bucket_is_always_served_and_none_that_is_empty(selection):
    random = np.random.default_rng(3)
    policy = assignment_of(selection, 5, 3)
    for _ in range(200):
        loads = random.integers(0, 2**30, 40) * (random.random(40) < random.random())
        loads[random.integers(40)] += 1
        buckets = policy.choose(loads)
        assert len(buckets) and (loads[buckets] > 0).all() and (np.diff(buckets) > 0).all()


@pytest.mark.parametrize(
    "cache, expected", [(0, [[2], [1], [1, 3]]), (30, [[2], [1, 2], [1, 3]]), (45, [[2], [1, 2], [1, 2, 3]])]
)
def test_treelets_that_were_visited_last_are_there(cache, expected, device):
    """Their sizes are 10, 20, 10 and 15; those that are visited are there whatever the cache holds."""
    there = wp.get_device(device)
    treelets = Treelets()
    treelets.nodes = wp.array([1, 2, 3, 4], dtype=wp.uint64, device=there)
    treelets.triangles = wp.array([5, 6, 7, 8], dtype=wp.uint64, device=there)
    recent = RecentTreelets(treelets, np.array([10, 20, 10, 15]), cache)
    for visited, shown in zip(([2], [1], [1, 3]), expected):
        assert recent.visit(np.array(visited)).tolist() == shown
        assert np.flatnonzero(recent.view.nodes.numpy()).tolist() == shown
    assert treelets.nodes.numpy().tolist() == [1, 2, 3, 4]


def test_processors_are_those_of_the_device_unless_said_otherwise(device):
    there = wp.get_device(device)
    assert processor_count(RenderSettings(), there) == (there.sm_count if there.is_cuda else 1)
    assert processor_count(RenderSettings(bucket_processors=7), there) == 7


@pytest.mark.parametrize("is_cuda", [False, True])
def test_a_sweep_alone_is_worth_while_for_many_rays(is_cuda):
    sweep = few_rays(RenderSettings(bucket_selection="ALL"), is_cuda)
    assert sweep > few_rays(RenderSettings(bucket_selection="MOST_FULL"), is_cuda)
    for chosen in ({"treelet_cache": 1}, {"treelet_prefetch": "ON"}):
        asked = RenderSettings(bucket_selection="ALL", **chosen)
        assert few_rays(asked, is_cuda) == few_rays(RenderSettings(bucket_selection="LAZY"), is_cuda) < sweep
