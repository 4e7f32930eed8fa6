"""Policies that serve several buckets in a step."""

import numpy as np
import pytest

from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.buckets.assigned.balanced import Balanced
from raybatch_addon.core.wavefront.tracers.buckets.assigned.lazy import Lazy
from raybatch_addon.core.wavefront.tracers.buckets.assigned.policies import ASSIGNMENTS
from raybatch_addon.core.wavefront.tracers.buckets.tracer import processor_count


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
    policy = Balanced(1)
    assert chosen(policy, 1, 9, 0, 5) == [1, 3]
    assert chosen(policy, 4, 0, 4) == [0, 2]
    assert chosen(policy, 0, 0, 1) == [2]


@pytest.mark.parametrize("selection", ASSIGNMENTS)
def test_some_bucket_is_always_served_and_none_that_is_empty(selection):
    random = np.random.default_rng(3)
    policy = ASSIGNMENTS[selection](5)
    for _ in range(200):
        loads = random.integers(0, 2**30, 40) * (random.random(40) < random.random())
        loads[random.integers(40)] += 1
        buckets = policy.choose(loads)
        assert len(buckets) and (loads[buckets] > 0).all() and (np.diff(buckets) > 0).all()


def test_processors_are_those_of_the_device_unless_said_otherwise(device):
    import warp as wp

    there = wp.get_device(device)
    assert processor_count(RenderSettings(), there) == (there.sm_count if there.is_cuda else 1)
    assert processor_count(RenderSettings(bucket_processors=7), there) == 7
