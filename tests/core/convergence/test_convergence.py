"""Recorder, metrics, references and their files, on pictures that are made up."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from raybatch_addon.core.convergence import points as convergence
from raybatch_addon.core.convergence.errors import squared_error_of_halves
from raybatch_addon.core.convergence.halves import half_error
from raybatch_addon.core.convergence.points import (
    ConvergenceRecorder,
    Reference,
    geometric_samples,
    noise_floor,
    relmse,
    relmse_of_halves,
    rmse,
    rmse_of_halves,
)
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.measure.snapshot import Snapshot
from tests.support.references import reference_of_runs

SHAPE = (40, 60, 3)


def snapshot(samples, picture, halves=None, seconds=None):
    seconds = 0.1 * samples if seconds is None else seconds
    return Snapshot(
        samples=samples,
        seconds=seconds,
        seconds_total=seconds + 1,
        rays={"camera": samples, "bounced": 2 * samples, "shadow": 0},
        invalid_samples=0,
        picture=picture,
        halves=halves,
    )


def nested_noise(seed, counts, truth, sigma=1.0):
    """Pictures of independent samples with variance sigma^2: each holds the samples of the one before."""
    random = np.random.default_rng(seed)
    total, before = np.zeros(SHAPE), 0
    for count in counts:
        total += random.normal(size=SHAPE) * math.sqrt(count - before) * sigma
        before = count
        yield truth + total / count


# --- sample counts


@pytest.mark.parametrize(
    "count, ratio, first, expected",
    [
        (1, 2, 1, [1]),
        (2, 2, 1, [1, 2]),
        (8, 2, 1, [1, 2, 4, 8]),
        (9, 2, 1, [1, 2, 4, 8, 9]),
        (100, 10, 1, [1, 10, 100]),
        (5, 1.1, 1, [1, 2, 3, 4, 5]),
        (64, 4, 2, [2, 8, 32, 64]),
        (3, 2, 8, [3]),
        (10, 1.5, 1, [1, 2, 3, 4, 5, 8, 10]),
    ],
)
def test_sample_counts_are_geometric_and_end_with_all(count, ratio, first, expected):
    assert geometric_samples(count, ratio, first) == expected


def test_sample_counts_always_ascend():
    for ratio in (1.01, 1.3, 2, math.e, 7):
        for count in (1, 2, 3, 17, 1000, 2**31 - 1 if ratio > 1.1 else 5000):
            counts = geometric_samples(count, ratio)
            assert counts[0] == 1 and counts[-1] == count and all(a < b for a, b in itertools.pairwise(counts))


@pytest.mark.parametrize("ratio", [1.0, 0.5, -2.0, math.nan])
def test_a_ratio_that_does_not_grow_is_refused(ratio):
    with pytest.raises(ValueError, match="above 1"):
        geometric_samples(8, ratio)
    with pytest.raises(ValueError, match="above 1"):
        ConvergenceRecorder(ratio)


# --- metrics


def test_errors_are_what_their_formulas_say():
    r = np.full(SHAPE, 0.5)
    x = r.copy()
    x[..., 0] += 0.3
    assert rmse(x, r) == pytest.approx(math.sqrt(0.09 / 3), rel=1e-14)
    assert relmse(x, r) == pytest.approx(0.03 / 0.26, rel=1e-14)
    assert rmse(r, r) == relmse(r, r) == 0
    assert relmse(x, np.zeros(SHAPE)) == pytest.approx(np.mean(x**2) / 0.01, rel=1e-14)


def test_errors_are_computed_in_float64():
    """A tiny difference on a large value of float32 pictures loses nothing but what float32 lost itself."""
    x = np.full(SHAPE, np.float32(1e6) + np.float32(0.0625), np.float32)
    assert rmse(x, np.full(SHAPE, 1e6)) == 0.0625


def test_the_error_of_halves_is_an_unbiased_estimate():
    """E (A - B)^2 / 4 = E ((A + B) / 2 - r)^2. Both are means of N independent chi-squared values: relative deviation
    sqrt(2 / N) each.

    A - B and A + B of normal variables are independent, and so are the two; 4 deviations of their difference are
    allowed.
    """
    random = np.random.default_rng(3)
    a, b = random.normal(2.0, 0.1, (2, *SHAPE))
    deviation = math.sqrt(2 * 2 / a.size)
    assert abs(rmse_of_halves(a, b) ** 2 / rmse((a + b) / 2, np.full(SHAPE, 2.0)) ** 2 - 1) < 4 * deviation < 0.15
    assert abs(relmse_of_halves(a, b) / relmse((a + b) / 2, np.full(SHAPE, 2.0)) - 1) < 4 * deviation
    assert rmse_of_halves(a, a) == relmse_of_halves(a, a) == 0


@pytest.mark.parametrize("samples", [(4, 4), (5, 4), (2, 1)])
def test_the_error_that_ends_a_render_is_that_of_the_recorder(samples):
    a, b = np.random.default_rng(6).gamma(0.3, 1.0, (2, *SHAPE)).astype(np.float32)
    n, m = samples
    kept = snapshot(n + m, ((n * a + m * b) / (n + m)).astype(np.float32), (a, b))
    point, found = convergence.error_point(kept), half_error(a, b, n + m)
    assert (point.rmse, point.relmse) == pytest.approx((found.rmse, found.relmse), rel=1e-12)
    if n == m:
        assert (rmse_of_halves(a, b), relmse_of_halves(a, b)) == pytest.approx((found.rmse, found.relmse), rel=1e-12)


def test_pixels_with_samples_of_their_own_number_have_each_its_weight():
    a, b = np.random.default_rng(6).gamma(0.3, 1.0, (2, *SHAPE))
    counts = np.full(SHAPE[:2], 9)
    assert half_error(a, b, counts) == half_error(a, b, 9)
    counts[0], counts[1] = 4, 0  # halves of one size; none at all
    error = squared_error_of_halves(a, b, counts)
    assert np.array_equal(error[0], squared_error_of_halves(a, b, 4)[0]) and not error[1].any()
    assert np.array_equal(error[2:], squared_error_of_halves(a, b, 9)[2:])


def test_pixels_without_two_samples_do_not_dilute_the_error():
    a, b = np.random.default_rng(6).gamma(0.3, 1.0, (2, *SHAPE)).astype(np.float32)
    counts = np.full(SHAPE[:2], 8)
    counts[0], counts[1] = 0, 1
    expected, found = half_error(a[2:], b[2:], 8), half_error(a, b, counts)
    point = convergence.error_point(dataclasses.replace(snapshot(8, (a + b) / 2, (a, b)), counts=counts))
    for each in (found, point):
        assert (each.rmse, each.relmse) == pytest.approx((expected.rmse, expected.relmse), rel=1e-12)
    assert point.samples == counts.mean() and point.samples_most == 8


def test_rare_light_does_not_hide_the_error():
    """One path in `1 / chance` brings `1 / chance`, so that each pixel is 1. Few pixels found it, and only a squared
    value that has no noise in it shows how far these are off; else each would count as 1 off, and 0.8 % of the picture.

    With few finds A B is 0 nearly everywhere and the estimate that of relMSE / 0.01, where the truth is that of relMSE
    / 1.01.
    """
    chance, samples = 1e-3, 4
    random = np.random.default_rng(8)
    a, b = random.binomial(samples, chance, (2, *SHAPE)) / (samples * chance)
    reported, true = relmse_of_halves(a, b), relmse((a + b) / 2, np.ones(SHAPE))
    assert true / 2 < reported < 150 * true
    # where pixels know their light, it is close: sums of 400 draws with 40 finds, so that E 1 / (A B) is above 1 by
    # some 3 / 20
    a, b = random.binomial(200, 0.1, (2, *SHAPE)) / 20
    assert relmse_of_halves(a, b) == pytest.approx(relmse((a + b) / 2, np.ones(SHAPE)), rel=0.3)


def test_pictures_of_other_sizes_are_refused():
    for metric in (rmse, relmse, rmse_of_halves, relmse_of_halves):
        with pytest.raises(RayBatchError, match="60 x 40 .*2 x 40 .*same size"):
            metric(np.zeros(SHAPE), np.zeros((40, 2, 3)))
        with pytest.raises(RayBatchError, match="without pixels"):
            metric(np.zeros((0, 4, 3)), np.zeros((0, 4, 3)))


# --- the recorder


def test_the_recorder_asks_for_a_geometric_series_and_computes_nothing_while_rendering(monkeypatch):
    recorder = ConvergenceRecorder(ratio=3)
    assert recorder.snapshot_samples(30) == [1, 3, 9, 27, 30]

    def computed(*_):
        raise AssertionError("computed while rendering")

    monkeypatch.setattr(convergence, "error_point", computed)
    picture = np.zeros(SHAPE, np.float32)
    recorder.on_snapshot(snapshot(1, picture))
    assert recorder.snapshots[0].picture is picture  # its own copy already: it is not copied again
    for other in (
        snapshot(1, picture),
        snapshot(9, picture, seconds=0.05),
    ):  # another render, and one that went on with a clock of its own
        with pytest.raises(ValueError, match="for one call"):
            recorder.on_snapshot(other)


def test_points_against_a_reference():
    truth = np.full(SHAPE, 0.7)
    counts = geometric_samples(64)
    recorder = ConvergenceRecorder()
    for count, picture in zip(counts, nested_noise(1, counts, truth, 0.2)):
        recorder.on_snapshot(snapshot(count, picture.astype(np.float32)))
    reference = Reference(truth, np.full(SHAPE, 1e-4), "truth", 99)
    points = recorder.points(reference)
    assert [p.samples for p in points] == counts
    for point, kept in zip(points, recorder.snapshots):
        assert (point.seconds, point.seconds_total, point.rays) == (kept.seconds, kept.seconds_total, kept.rays)
        assert (point.rmse, point.relmse) == pytest.approx(
            (rmse(kept.picture, truth), relmse(kept.picture, truth)), rel=1e-12
        )
        assert point.flip is None and not point.from_halves
        assert point.floor_rmse == pytest.approx(0.01) and point.floor_relmse == pytest.approx(1e-4 / 0.5)
        # 2400 pixels whose squared error is a mean of three: chi-squared, relative deviation of the root 1 / sqrt(2 *
        # 7200). That estimate itself is the root of a variance of 2400 values with kurtosis 3 + 12 / 3: deviation
        # sqrt(6 / 2400) / 2, here times 4
        assert point.rmse_spread == pytest.approx(
            point.rmse / math.sqrt(2 * truth.size), rel=4 * math.sqrt(6 / 2400) / 2
        )


def test_points_without_a_reference_come_from_halves():
    a, b = np.random.default_rng(5).normal(1, 0.1, (2, *SHAPE)).astype(np.float32)
    recorder = ConvergenceRecorder()
    recorder.on_snapshot(snapshot(1, a, (a, np.zeros_like(a))))  # its second half is empty: no point
    recorder.on_snapshot(snapshot(2, (a + b) / 2, (a, b)))
    (point,) = recorder.points()
    assert point.from_halves and point.samples == 2 and point.floor_rmse == 0
    assert (point.rmse, point.relmse) == pytest.approx(
        (rmse_of_halves(a, b), relmse_of_halves(a, b)), rel=1e-7
    )  # the mean is float32


def test_without_reference_and_halves_nothing_gives_the_error():
    recorder = ConvergenceRecorder()
    assert recorder.points() == []
    recorder.on_snapshot(snapshot(4, np.zeros(SHAPE)))
    with pytest.raises(RayBatchError, match="error_estimate to ON"):
        recorder.points()
    with pytest.raises(RayBatchError, match="same size"):
        recorder.points(Reference(np.zeros((2, 2, 3))))


def test_flip_gets_the_pictures_top_row_first():
    recorder = ConvergenceRecorder()
    picture = np.arange(np.prod(SHAPE), dtype=np.float32).reshape(SHAPE)
    recorder.on_snapshot(snapshot(1, picture))
    seen = []
    reference = Reference(picture + 1.0)
    points = recorder.points(reference, flip=lambda x, r: seen.append((x, r)) or 0.25)
    assert points[0].flip == 0.25
    assert (
        np.array_equal(seen[0][0], picture[::-1])
        and np.array_equal(seen[0][1], (picture + 1)[::-1])
        and seen[0][1].dtype == np.float32
    )


# --- references


def test_the_noise_floor_is_what_the_reference_adds():
    random = np.random.default_rng(7)
    truth = random.uniform(0.2, 1, SHAPE)
    runs = truth + random.normal(0, 0.1, (8, *SHAPE))
    reference = reference_of_runs(runs, "runs", 800)
    floor_rmse, floor_relmse = noise_floor(reference)
    # both are means over 7200 values: of chi-squared with 7 degrees of freedom, and with 1; 4 deviations of their
    # difference
    deviation = math.sqrt((2 / 7 + 2) / truth.size)
    assert floor_rmse**2 == pytest.approx(rmse(reference.picture, truth) ** 2, rel=4 * deviation)
    assert floor_relmse == pytest.approx(
        relmse(reference.picture, truth), rel=8 * deviation
    )  # weights vary from pixel to pixel
    halves = Reference.of_halves(runs[0], runs[1], "halves", 200)
    assert noise_floor(halves)[0] == pytest.approx(rmse_of_halves(runs[0], runs[1]))
    assert noise_floor(Reference(truth, np.zeros(SHAPE))) == (0, 0)
    assert all(math.isnan(value) for value in noise_floor(Reference(truth)))
