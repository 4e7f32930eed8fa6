"""The choice whether to sort, without a device: costs are made up here."""

from collections import deque

import pytest

from raybatch_addon.core.wavefront.order.sort_policy import (
    BOUNCE_1,
    BOUNCE_LATER,
    CAMERA,
    RAY_CLASSES,
    RAYS_MIN,
    SHADOW,
    TRIAL_SPACING,
    TRIAL_WAVES,
    SortPolicy,
    merged_reports,
)

FIRST = 1000
WAVE = 5000


def play(policy, costs, waves, items=FIRST, late=0, ray_class=BOUNCE_1, rays=WAVE, items_a_wave=0):
    """Trace `waves` waves that cost `costs[sorted]` [s] a ray, told `late` waves later; what was chosen."""
    chosen, reported = [], deque()
    for _ in range(waves):
        sorts = policy.choose(ray_class, rays, items)
        chosen.append(sorts)
        reported.append((policy.is_measured(ray_class), sorts))
        while len(reported) > late:
            is_measured, sorts = reported.popleft()
            if is_measured:
                policy.record(ray_class, sorts, rays, rays * costs[sorts])
        items += items_a_wave
    return chosen


@pytest.mark.parametrize("mode", ["ON", "OFF"])
def test_on_and_off_are_obeyed_and_never_measured(mode):
    policy = SortPolicy(mode, FIRST)
    for ray_class in RAY_CLASSES:
        for rays in (1, 10**6):
            assert policy.choose(ray_class, rays, 10**9) is (mode == "ON")
            assert not policy.is_measured(ray_class)
    assert all(each["sorted"] is (mode == "ON") for each in policy.report()["classes"].values())


@pytest.mark.parametrize("late", [0, 1, 4])
@pytest.mark.parametrize("costs", [(2e-9, 1e-9), (1e-9, 2e-9)], ids=["sorting pays", "sorting costs"])
def test_the_cheaper_way_is_kept(costs, late):
    chosen = play(SortPolicy("AUTO", FIRST), costs, 40, late=late)
    assert chosen[: 2 * TRIAL_WAVES] == [False, True] * TRIAL_WAVES
    assert set(chosen[2 * TRIAL_WAVES + late :]) == {costs[True] < costs[False]}


def test_nothing_is_tried_before_the_first_point():
    assert not any(play(SortPolicy("AUTO", FIRST), (2e-9, 1e-9), 20, items=FIRST - 1))


def test_trials_come_at_fixed_points_of_the_work():
    policy = SortPolicy("AUTO", FIRST)
    items, begun = FIRST, []
    for _ in range(2000):
        sorts = policy.choose(SHADOW, WAVE, items)
        if policy.is_measured(SHADOW):
            begun.append(items)
            policy.record(SHADOW, sorts, WAVE, WAVE * 1e-9)
        items += 500
    expected = [FIRST * TRIAL_SPACING**k + 500 * i for k in range(3) for i in range(2 * TRIAL_WAVES)]
    assert begun == expected
    assert policy.report()["classes"][SHADOW]["trials"] == 3


def test_a_choice_is_changed_when_the_work_changes_and_not_for_little():
    policy = SortPolicy("AUTO", FIRST)
    assert play(policy, (2e-9, 1e-9), 10)[-1] is True
    assert play(policy, (0.95e-9, 1e-9), 10, items=TRIAL_SPACING * FIRST)[-1] is True, "within the noise"
    assert play(policy, (0.5e-9, 1e-9), 10, items=TRIAL_SPACING**2 * FIRST)[-1] is False
    report = policy.report()["classes"][BOUNCE_1]
    assert (report["trials"], report["switches"]) == (3, 2)
    assert (report["ns_unsorted"], report["ns_sorted"]) == (0.5, 1.0)


def test_one_slow_wave_does_not_decide():
    policy, costs = SortPolicy("AUTO", FIRST), iter([9e-9, 1e-9, 2e-9, 9e-9, 2e-9, 1e-9])
    for _ in range(2 * TRIAL_WAVES):
        policy.record(CAMERA, policy.choose(CAMERA, WAVE, FIRST), WAVE, WAVE * next(costs))
    assert policy.choose(CAMERA, WAVE, FIRST) is True


def test_classes_are_decided_apart():
    policy = SortPolicy("AUTO", FIRST)
    play(policy, (2e-9, 1e-9), 10, ray_class=BOUNCE_LATER)
    play(policy, (1e-9, 2e-9), 10, ray_class=CAMERA)
    assert policy.choose(BOUNCE_LATER, WAVE, FIRST) and not policy.choose(CAMERA, WAVE, FIRST)


def test_small_waves_are_left_alone_and_count_for_nothing():
    policy = SortPolicy("AUTO", FIRST)
    assert not any(play(policy, (2e-9, 1e-9), 20, rays=RAYS_MIN - 1))
    # on a device whose counts are not known yet a wave may turn out to be small afterwards
    for _ in range(20):
        policy.record(BOUNCE_1, policy.choose(BOUNCE_1, WAVE, FIRST), RAYS_MIN - 1, 1.0)
    assert play(policy, (2e-9, 1e-9), 10)[-1] is True


def test_waves_that_are_never_reported_leave_the_choice_as_it_was_until_the_next_point():
    policy = SortPolicy("AUTO", FIRST)
    for _ in range(3 * TRIAL_WAVES):
        policy.choose(BOUNCE_1, WAVE, FIRST)
    assert not policy.choose(BOUNCE_1, WAVE, FIRST)
    assert play(policy, (2e-9, 1e-9), 10, items=TRIAL_SPACING * FIRST)[-1] is True


def test_reports_of_workers_are_merged():
    one, other = SortPolicy("AUTO", FIRST), SortPolicy("AUTO", FIRST)
    play(one, (2e-9, 1e-9), 10)
    play(other, (1e-9, 3e-9), 10)
    other.choose(SHADOW, WAVE, 0)
    merged = merged_reports([one.report(), other.report()])
    assert merged["mode"] == "AUTO" and list(merged["classes"]) == [BOUNCE_1, SHADOW]
    bounced = merged["classes"][BOUNCE_1]
    assert (bounced["sorted"], bounced["trials"], bounced["ns_unsorted"], bounced["ns_sorted"]) == (0.5, 2, 1.5, 2.0)
    assert bounced["waves_sorted"] + bounced["waves_unsorted"] == 20
    assert merged["classes"][SHADOW]["ns_sorted"] is None
    assert merged_reports([]) is None
