"""When the noise of pixels is looked at: counts that settings alone decide."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.adaptive.looks import LOOKS_AN_OCTAVE, Looks
from raybatch_addon.core.wavefront.render.rounds import RoundPolicy

ADAPTIVE = RenderSettings(adaptive_sampling="ON")


@pytest.mark.parametrize(
    ("changes", "first"),
    [
        ({}, 64),
        ({"noise_threshold": 0.1}, 32),
        ({"noise_threshold": 0.001}, 128),
        ({"adaptive_samples_min": 1}, 2),
        ({"adaptive_samples_min": 7}, 8),
        ({"adaptive_samples_min": 100}, 100),
    ],
)
def test_the_first_look_is_after_an_even_number_of_samples(changes, first):
    assert Looks.of(ADAPTIVE.replace(**changes)).first == first


@pytest.mark.parametrize("changes", [{"adaptive_sampling": "OFF"}, {"noise_threshold": 0.0}])
def test_nothing_ends_without_looks(changes):
    assert Looks.of(ADAPTIVE.replace(**changes)) is None


@given(st.integers(1, 2**30).map(lambda half: 2 * half), st.integers(0, 2**34))
def test_looks_are_even_and_follow_in_each_octave(first, samples):
    looks = Looks(first)
    following = looks.after(samples)
    assert following > samples and following % 2 == 0 and following >= first
    assert looks.after(following - 1) == following == looks.last_until(following)
    if samples >= first:
        # one step of the octave that the samples are in, rounded up to an even number
        assert following <= samples + samples / LOOKS_AN_OCTAVE + 2


@given(st.integers(1, 2**20))
def test_the_last_look_is_the_greatest_so_far(samples):
    looks = Looks(8)
    last = looks.last_until(samples)
    assert last <= samples < looks.after(samples) and (last == 0) == (samples < 8)


def test_rounds_end_at_every_look_and_at_marks_of_others():
    policy = RoundPolicy.of(ADAPTIVE.replace(sample_count=50, adaptive_samples_min=8), [5, 30])
    assert policy.is_cut
    ends, done = [], 0
    while (end := policy.next_end(done, 0.0)) is not None:
        ends.append(done := end)
    assert ends == [5, 8, 12, 16, 24, 30, 32, 48, 50] and policy.stopped_by == "samples"
    assert [end for end in ends if policy.looks_at_noise(end)] == [8, 12, 16, 24, 32, 48]


def test_a_render_without_active_pixels_is_over():
    policy = RoundPolicy.of(ADAPTIVE, [])
    assert policy.next_end(64, 0.0, 0.0) is None and policy.stopped_by == "noise"


def test_a_part_of_a_round_looks_at_nothing():
    policy = RoundPolicy.of(ADAPTIVE, [], 64)
    assert policy.looks is None and not policy.is_cut and policy.next_end(0, 0.0) == ADAPTIVE.sample_count


def test_few_active_pixels_leave_time_for_more_samples():
    def end(share):
        policy = RoundPolicy(10**6, time_limit=100.0)
        policy.note_round(10, 10.0, None)  # a sample of every pixel takes a second
        return policy.next_end(1000, 90.0, share)

    assert end(1.0) - 1000 == 9 and end(0.1) - 1000 == 95
