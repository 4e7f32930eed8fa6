"""scripts/compare.py: its mathematics, and its judgement by superposition."""

import math

import numpy as np
import pytest
from real_files import measures
from real_files.judging import TOO_NOISY, UNDECIDED, judge
from real_files.measures import Pair, Spread, agreement, equal_error, noise_of

SIZE = (64, 96, 3)


def pair(seed: int, value=0.5, noise: float = 0.0) -> Pair:
    """Two pictures of `value`, each with normal noise of its own."""
    rng = np.random.default_rng(seed)
    return Pair(*(value + noise * rng.standard_normal(SIZE) for _ in range(2)))


# --- mathematics


def test_noise_alone_is_the_same_picture_and_explains_all_of_relmse():
    found = agreement(pair(1, noise=0.3), pair(2, noise=0.3))
    assert found.same and found.relmse == pytest.approx(found.noise, rel=0.3)
    assert abs(found.ratio - 1) < 4 * found.ratio_error < 0.02


def test_three_percent_of_brightness_or_a_wrong_corner_is_another_picture():
    assert not agreement(pair(1, 0.515, 0.01), pair(2, 0.5, 0.01)).same
    wrong = np.full(SIZE, 0.5)
    wrong[:16, :16] = 0.0
    found = agreement(Pair(wrong, wrong), pair(2, noise=0.01))
    assert found.relmse > found.relmse_most and not found.same
    assert found.share_off == pytest.approx(16 * 16 / (64 * 96), rel=0.01)


def test_what_surrounds_an_object_in_the_dark_does_not_hide_that_it_is_darker():
    lit = np.zeros(SIZE)
    lit[:20, :20] = 0.5
    found = agreement(Pair(lit * 0.95, lit * 0.95), Pair(lit, lit))
    assert found.typical == pytest.approx(0.95, abs=2e-3) and found.bias == pytest.approx(0.05) and not found.same


def test_noise_that_is_skewed_is_no_bias():
    rng = np.random.default_rng(4)
    rare = Pair(*(0.5 * 20 * (rng.random(SIZE) < 0.05) for _ in range(2)))
    found = agreement(rare, pair(5, 0.5, 0.05))
    assert abs(found.typical - 1) > 0.02 and found.bias == 0.0


def test_black_pictures_are_the_same_and_have_no_ratio():
    black = Pair(np.zeros(SIZE), np.zeros(SIZE))
    found = agreement(black, black)
    assert found.same and math.isnan(found.ratio) and found.data()["ratio"] is None
    assert math.isnan(measures.Agreement.of_data(found.data()).ratio)


def test_the_standard_error_of_the_ratio_is_that_of_many_renders():
    found = [agreement(pair(2 * i, noise=0.2), pair(2 * i + 1, noise=0.2)) for i in range(200)]
    spread = np.std([each.ratio for each in found])
    # channels are independent here
    assert np.mean([each.ratio_error for each in found]) == pytest.approx(spread, rel=0.2)


def test_noise_is_the_relative_variance_of_one_picture_and_fireflies_are_cut():
    noisy = pair(1, noise=0.1)
    shown = np.full(SIZE, 0.5)
    assert noise_of(noisy, shown) == pytest.approx(0.01 / (0.25 * 1.01), rel=0.05)
    noisy.first[0, 0] = 1e9
    assert noise_of(noisy, shown) < 0.05


def test_time_at_equal_error_weighs_seconds_by_noise():
    assert equal_error((2.0, 0.1), (1.0, 0.4)) == pytest.approx(0.5)
    assert equal_error((2.0, 0.1), (1.0, 0.0)) is None


def test_the_interval_of_a_median_holds_the_true_one_as_often_as_it_says():
    rng = np.random.default_rng(3)
    drawn = [Spread.of({str(i): x for i, x in enumerate(rng.lognormal(size=41))}) for _ in range(60)]
    assert sum(each.low <= 1 <= each.high for each in drawn) >= 52
    assert all(each.low <= each.median <= each.high <= each.worst for each in drawn)
    assert Spread.of({}) is None and Spread.of({"a": 1.0, "b": 3.0}).worst_of == "b"


# --- superposition


def pictures(engine_loss: float = 0.0, lamp: float = 1.0, noise: float = 0.01, seed: int = 0):
    """Pictures of all sources and of each alone by an engine that loses a share of the light of all."""
    alone = {"lamp “A”": pair(seed + 1, 0.3 * lamp, noise), "the world": pair(seed + 2, 0.2, noise)}
    everything = pair(seed + 3, (0.3 * lamp + 0.2) * (1 - engine_loss), noise)
    return everything, alone


def judged(cycles, raybatch):
    return judge({"CYCLES": cycles[0], "RAYBATCH": raybatch[0]}, {"CYCLES": cycles[1], "RAYBATCH": raybatch[1]})


@pytest.mark.parametrize("right, losses", [("RayBatch", (0.13, 0.0)), ("Cycles", (0.0, 0.13))])
def test_an_engine_that_loses_light_where_lamps_overlap_is_wrong(right, losses):
    found = judged(pictures(losses[0]), pictures(losses[1], seed=10))
    assert found.right == right and "0.870 ±" in found.why and "alone, all sources look the same" in found.why
    assert all(each.same for each in found.sources.values())


def test_where_both_add_up_the_source_that_differs_is_named():
    found = judged(pictures(), pictures(lamp=0.8, seed=10))
    assert found.right == UNDECIDED and "what differs is in the pictures of lamp “A” alone" in found.why
    assert judged(pictures(), pictures(seed=10)).why.startswith("both engines' pictures add up, and show the same")


def test_where_neither_adds_up_or_noise_hides_it_nobody_is_right():
    assert judged(pictures(0.1), pictures(0.2, seed=10)).right == UNDECIDED
    assert judged(pictures(noise=6.0), pictures(noise=6.0, seed=10)).right == TOO_NOISY
