"""Which queue is served next: the specification, without a device, and its twin on every device."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.wavefront.tracers.buckets.assigned.policies import SEVERAL, assignment_of
from raybatch_addon.core.wavefront.tracers.buckets.blocks import OVERFLOW, STEP, WAITING
from raybatch_addon.core.wavefront.tracers.buckets.policy import BucketChoice, BucketPolicy, Selection, Step
from raybatch_addon.core.wavefront.tracers.buckets.policy_device import QUEUE, RULES, STEP_KIND, DevicePolicy
from raybatch_addon.core.wavefront.tracers.buckets.queues import BucketQueues


def choose(policy, *pairs, since=None, step=0, overflowing=0):
    """`pairs`: rays in the entry and the exit queue of each bucket, the root's last."""
    counts = [count for pair in pairs for count in pair]
    return policy.choose(counts, since or [0] * len(counts), step, overflowing)


def test_the_fullest_bucket_is_served_and_of_it_the_larger_queue():
    policy = BucketPolicy(Selection.MOST_FULL, 0, 0, 3)
    assert choose(policy, (5, 0), (3, 4), (6, 0), (0, 0)) == BucketChoice(Step.TOP, 3)
    assert choose(policy, (5, 0), (3, 1), (6, 0), (0, 0)) == BucketChoice(Step.TREELET, 4)
    assert choose(policy, (5, 0), (3, 1), (5, 0), (0, 0)) == BucketChoice(Step.TREELET, 0)  # the first of equals
    assert choose(policy, (2, 2), (0, 0), (0, 0), (0, 0)) == BucketChoice(Step.TREELET, 0)


def test_rays_that_are_done_are_no_work():
    policy = BucketPolicy(Selection.MOST_FULL, 3, 0, 1)
    assert choose(policy, (0, 0), (9, 0), step=50) == BucketChoice(Step.NOTHING)
    assert choose(policy, (2, 0), (9, 1), since=[49, 0, 0, 49], step=50) == BucketChoice(Step.TREELET, 0)
    assert choose(policy, (0, 0), (9, 1), since=[49, 0, 0, 49], step=50) == BucketChoice(Step.TOP, 3)


def test_next_goes_round():
    policy = BucketPolicy(Selection.NEXT, 0, 0, 3)
    pairs = (1, 0), (0, 0), (1, 2), (0, 1)
    assert [choose(policy, *pairs).queue for _ in range(5)] == [0, 5, 7, 0, 5]


def test_random_depends_on_the_seed_and_meets_every_bucket():
    def drawn(seed):
        policy = BucketPolicy(Selection.RANDOM, 0, seed, 7)
        return [
            choose(policy, *[(1, 0)] * 3, (0, 0), *[(1, 0)] * 3, (0, 0), step=step).queue // 2 for step in range(600)
        ]

    first = drawn(1)
    assert first == drawn(1) != drawn(2)
    counts = np.bincount(first, minlength=8)
    assert counts[3] == counts[7] == 0
    assert counts[[0, 1, 2, 4, 5, 6]].min() > 60  # of 100 expected; 5 sigma would be 54


@pytest.mark.parametrize("selection", [each for each in RULES if each != Selection.ALL])
def test_no_ray_waits_longer_than_it_may(selection):
    """With new rays in front of every step, a queue that is never the fullest is served in time."""
    policy = BucketPolicy(selection, 10, 5, 30)
    rng = np.random.default_rng(0)
    counts, since = np.zeros(62, int), np.zeros(62, int)
    longest = 0
    for step in range(500):
        for queue in [*rng.integers(0, 8, 30), 33]:
            since[queue] = since[queue] if counts[queue] else step
            counts[queue] += 1
        queue = policy.choose(counts.tolist(), since.tolist(), step).queue
        longest = max(longest, step - since[queue])
        counts[queue] = 0
    assert 10 <= longest <= 10 + 9  # others that wait too come first


def test_few_rays_go_on_alone():
    policy = BucketPolicy(Selection.NEXT, 0, 0, 2, rays_few=5)
    assert choose(policy, (2, 3), (0, 0), (0, 0)).step == Step.TOP
    assert choose(policy, (2, 2), (4, 0), (9, 3)) == BucketChoice(Step.UNBATCHED)
    sweep = BucketPolicy(Selection.ALL, 0, 0, 2, rays_few=5)
    assert choose(sweep, (2, 2), (1, 0), (9, 0)) == BucketChoice(Step.SWEEP)
    assert choose(sweep, (2, 2), (0, 0), (9, 0)) == BucketChoice(Step.UNBATCHED)


def test_the_fullest_bucket_is_drained_when_blocks_ran_out():
    policy = BucketPolicy(Selection.NEXT, 0, 0, 3)
    assert choose(policy, (1, 0), (7, 0), (8, 0), (0, 0), overflowing=1).queue == 4
    assert choose(policy, (1, 0), (7, 0), (8, 0), (0, 0)).queue == 0  # the next again


def test_a_selection_without_a_rule_is_refused():
    policy = BucketPolicy(len(Selection), 0, 0, 1)
    with pytest.raises(ValueError, match="no rule for the selection"):
        choose(policy, (1, 0), (0, 0))
    blocks = BucketQueues(4, 1, 1, 1, wp.get_device("cpu")).blocks
    with pytest.raises(ValueError, match="no rule for the selection"):
        DevicePolicy(len(Selection), 0, 0, 1, 0, blocks)
    with pytest.raises(ValueError, match="no policy for the selection"):
        assignment_of(len(Selection), 1, 0)
    assert sorted([*RULES, *SEVERAL]) == list(Selection)


@pytest.mark.parametrize("selection", [each for each in RULES if each != Selection.ALL])
def test_policies_that_the_host_asks_choose_the_same(selection):
    policy, asked = BucketPolicy(selection, 0, 7, 30), assignment_of(selection, 1, 7)
    random = np.random.default_rng(1)
    for step in range(50):
        counts = random.integers(0, 9, 62) * (random.random(62) < 0.2)
        counts[60], counts[random.integers(60)] = 0, 1
        expected = policy.choose(counts.tolist(), [0] * 62, step).queue // 2
        assert asked.choose(counts[0::2] + counts[1::2]).tolist() == [expected]


WAYS = [("cpu", False), ("cpu", True)] + [(device.alias, True) for device in wp.get_cuda_devices()]


@pytest.mark.parametrize("way", WAYS, ids=lambda way: f"{way[0]}-{'parallel' if way[1] else 'sequential'}")
@pytest.mark.parametrize("selection", RULES)
@pytest.mark.parametrize("bucket_count", [1, 9, 5000])
def test_the_twin_chooses_the_same(way, selection, bucket_count):
    device, parallel = wp.get_device(way[0]), way[1]
    rng = np.random.default_rng(bucket_count + selection)
    queue_total = 2 * bucket_count + 2
    for trial in range(12):
        seed, wait_max, few = (
            (-(2**31) + trial if trial % 2 else 2**31 - trial),
            [0, 4, 30][trial % 3],
            [0, 3, 40][trial // 4],
        )
        policy = BucketPolicy(selection, wait_max, seed, bucket_count, few)
        blocks = BucketQueues(queue_total, 1, 1, 1, device, parallel=parallel).blocks
        twin = DevicePolicy(selection, wait_max, seed, bucket_count, few, blocks, parallel)
        for step in range(6):
            counts = rng.integers(0, 60, queue_total) * (rng.random(queue_total) < rng.choice([0.0, 0.01, 0.3, 1.0]))
            since = step + 7 - rng.integers(0, 50, queue_total)
            overflowing = int(rng.random() < 0.3)
            state = np.zeros(blocks.state.size, np.int32)
            state[STEP], state[OVERFLOW], state[WAITING] = step + 7, overflowing, counts.sum()
            for array, values in ((blocks.counts, counts), (blocks.since, since), (blocks.state, state)):
                array.assign(values.astype(np.int32))
            twin.launch()
            chosen = twin.state.choice.numpy()
            expected = policy.choose(counts.tolist(), since.tolist(), step + 7, overflowing)
            assert BucketChoice(Step(chosen[STEP_KIND]), int(chosen[QUEUE])) == expected
