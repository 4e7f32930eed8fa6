"""How far rounds go, when a render ends, and which samples are whose; without a device."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.render.rounds import ERROR_SAMPLES_LEAST, Round, RoundPolicy, sample_marks
from raybatch_addon.core.wavefront.stages.limits import half_seed


def ends(policy: RoundPolicy, seconds_a_sample: float = 0.0, error_of=None, fixed: float = 0.0) -> list[int]:
    """Ends of all rounds, where a round of n samples takes `fixed + n * seconds_a_sample`, and `error_of(samples)` is
    the relMSE.
    """
    done, seconds, found = 0, 0.0, []
    while (end := policy.next_end(done, seconds)) is not None:
        assert done < end <= policy.sample_count
        took = fixed + (end - done) * seconds_a_sample
        seconds += took
        policy.note_round(end - done, took, error_of(end) if error_of and policy.looks_at_error(end) else None)
        done = end
        found.append(done)
    return found


def test_a_render_that_nobody_watches_is_one_round():
    policy = RoundPolicy.of(RenderSettings(sample_count=77), [])
    assert not policy.is_cut and ends(policy) == [77] and policy.stopped_by == "samples"
    assert not RoundPolicy.of(RenderSettings(sample_count=77, error_estimate="ON"), [77]).is_cut


@given(st.integers(1, 300), st.lists(st.integers(-3, 400)))
def test_rounds_end_at_each_mark_and_at_the_last_sample(count, wanted):
    policy = RoundPolicy.of(RenderSettings(sample_count=count), wanted)
    assert ends(policy) == sorted({mark for mark in wanted if 1 <= mark <= count} | {count})


def test_marks_are_distinct_and_in_order():
    assert sample_marks([5, 1, 5, 0, 9, -2, 8], 8) == (1, 5, 8)


@given(st.integers(0, 2**40), st.integers(0, 10**6), st.integers(0, 10**6))
def test_halves_have_every_sample_once(first, count, more):
    one, two = Round(first, first + count), Round(first + count, first + count + more)
    for half in (0, 1):
        mine = one.of_half(half, 2)
        assert mine.end == two.of_half(half, 2).first  # ranges that adjoin do so in each half
        assert abs(mine.sample_count - count / 2) <= 0.5
    assert sum(one.of_half(half, 2).sample_count for half in (0, 1)) == count
    assert one.of_half(0, 1) == one
    if count < 20:
        for half in (0, 1):
            mine = one.of_half(half, 2)
            assert [i // 2 for i in range(one.first, one.end) if i % 2 == half] == list(range(mine.first, mine.end))


@given(st.integers(0, 2**31 - 1))
def test_the_second_half_has_a_legal_seed_of_its_own(seed):
    assert half_seed(seed, 0) == seed and half_seed(seed, 1) != seed
    RenderSettings(seed=half_seed(seed, 1))


def test_seeds_of_second_halves_seldom_meet():
    seeds = range(20_000)
    # n seeds drawn from 2^31 are expected to have n^2 / 2^32 equal pairs: 0.09 here
    assert len({half_seed(seed, 1) for seed in seeds}) >= len(seeds) - 3
    assert not set(seeds) & {half_seed(seed, 1) for seed in range(100)}


# --- the error


def test_rounds_double_until_the_error_is_close_and_then_go_as_far_as_it_asks():
    found = ends(policy := RoundPolicy(10_000, error_target=0.01), error_of=lambda n: 1.0 / n)
    assert found[:3] == [4, 8, 16] and policy.stopped_by == "error"
    assert 100 <= found[-1] <= 102 and len(found) <= 8
    assert all(b <= 2 * a for a, b in itertools.pairwise(found)) and all(end % 2 == 0 for end in found)


@given(st.floats(1e-6, 1.0), st.floats(0.5, 1.5), st.floats(1e-7, 2.0), st.lists(st.integers(1, 5000)))
def test_neither_marks_nor_a_clock_that_does_not_stop_change_where_it_ends(target, slope, noise, marks):
    def error_of(n):
        return noise * n**-slope * (1.5 + math.sin(n))

    plain = ends(one := RoundPolicy(4096, error_target=target), error_of=error_of)
    other = RoundPolicy(4096, sample_marks(marks, 4096), time_limit=1e6, error_target=target)
    found = ends(other, 1e-3, error_of)
    assert found[-1] == plain[-1] and set(plain) <= set(found) and one.stopped_by == other.stopped_by
    assert plain[0] == min(4096, ERROR_SAMPLES_LEAST) and len(plain) < 60


def test_no_error_at_all_reaches_any_target():
    assert (
        ends(policy := RoundPolicy(100, error_target=1e-9), error_of=lambda n: 0.0) == [4]
        and policy.stopped_by == "error"
    )


def test_an_error_that_is_not_reached_ends_with_the_samples():
    assert (
        ends(policy := RoundPolicy(37, error_target=1e-9), error_of=lambda n: 1.0)[-1] == 37
        and policy.stopped_by == "samples"
    )
    assert (
        ends(policy := RoundPolicy(2, error_target=0.5), error_of=lambda n: 1.0) == [2]
        and policy.stopped_by == "samples"
    )


@given(st.integers(1, 10), st.floats(1e-4, 1.0))
def test_a_render_that_goes_on_looks_at_the_error_where_it_would_have(cut, target):
    def error_of(n):
        return 1.0 / n

    plain = ends(RoundPolicy(512, error_target=target), error_of=error_of)
    policy, done = RoundPolicy(512, (3, 5), error_target=target), 0
    settings = RenderSettings(sample_count=512, error_target=target)
    for _ in range(cut):
        end = policy.next_end(done, 0.0)
        if end is None:
            break
        policy.note_round(end - done, 0.0, error_of(end) if policy.looks_at_error(end) else None)
        done = end
        policy = policy.resumed(settings, [7, 100])
    found = [done]
    while (end := policy.next_end(found[-1], 0.0)) is not None:
        policy.note_round(1, 0.0, error_of(end) if policy.looks_at_error(end) else None)
        found.append(end)
    assert found[-1] == plain[-1]


# --- the clock


@given(st.floats(0.01, 100.0), st.floats(1e-6, 10.0), st.floats(0.0, 0.1))
def test_no_round_is_begun_that_does_not_fit(limit, seconds_a_sample, fixed):
    policy = RoundPolicy(2**31 - 1, time_limit=limit)
    found = ends(policy, seconds_a_sample, fixed=fixed)
    assert found[0] == 1 and policy.stopped_by == "time"
    spent = len(found) * fixed + found[-1] * seconds_a_sample
    # a sample's share of `fixed` falls as rounds grow, and rises again with the last, short ones: each may be late by
    # it
    assert len(found) == 1 or spent <= limit + fixed
    assert all(b <= 2 * a for a, b in itertools.pairwise(found))
    if fixed == 0.0 and found[-1] > 1000:
        assert spent > 0.9 * limit


def test_a_render_that_goes_on_tries_one_sample_before_more():
    policy = RoundPolicy(10**6, time_limit=1.0).resumed(RenderSettings(sample_count=10**6, time_limit=1.0), [])
    policy.note_round(0, 0.0, None)  # nothing was left of the round under way
    assert policy.next_end(1000, 0.0) == 1001
    policy.note_round(1, 2.0, None)
    assert policy.next_end(1001, 2.0) is None and policy.stopped_by == "time"


def test_a_limit_that_is_never_reached_ends_with_the_samples():
    assert ends(policy := RoundPolicy(100, time_limit=1e9), 1e-3)[-1] == 100 and policy.stopped_by == "samples"


@pytest.mark.parametrize("limit", [1e-9, 0.5])
def test_one_sample_is_always_rendered(limit):
    assert ends(policy := RoundPolicy(100, time_limit=limit), 1.0) == [1] and policy.stopped_by == "time"
