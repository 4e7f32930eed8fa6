"""Slopes, flattening, times and efficiencies of curves that are made up."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.convergence.fit import t_exceeds
from raybatch_addon.core.convergence.points import ErrorPoint, efficiency, fit_slope, geometric_samples, time_to

PIXELS = 1000


def point(samples, error, *, floor=0.0, spread=None, seconds=None, from_halves=False):
    seconds = samples / 100 if seconds is None else seconds
    return ErrorPoint(
        seconds=seconds,
        seconds_total=seconds + 1,
        samples=samples,
        rays={},
        rmse=error,
        relmse=error**2 / 2,
        rmse_spread=spread,
        floor_rmse=floor,
        floor_relmse=None if floor is None else floor**2 / 2,
        from_halves=from_halves,
    )


def curve(error_of, sample_count=1024, **more):
    return [point(n, error_of(n), **more) for n in geometric_samples(sample_count)]


def measured(seed, sample_count=1024, bias=0.0, noise=0.0, draw=None, floor=None):
    """The curve of a nested render of `PIXELS` pixels: `draw(random, count)` sums `count` samples with mean 0."""
    random = np.random.default_rng(seed)
    draw = draw or (lambda random, count: random.normal(size=PIXELS) * math.sqrt(count))
    reference = random.normal(size=PIXELS) * noise
    bias = bias * random.exponential(size=PIXELS)
    total, before, points = np.zeros(PIXELS), 0, []
    for count in geometric_samples(sample_count):
        total = total + draw(random, count - before)
        before = count
        error = np.square(total / count + bias - reference)
        root = math.sqrt(error.mean())
        spread = error.std(ddof=1) / math.sqrt(PIXELS) / (2 * root)
        points.append(point(count, root, floor=noise if floor is None else floor, spread=spread))
    return points


# --- the line


@pytest.mark.parametrize("power", [-0.5, -0.75, -1.5])
def test_a_power_law_is_found_exactly(power):
    for by, factor in (("samples", 1), ("seconds", 100)):
        slope = fit_slope(curve(lambda n: 3 * n**power), by)
        assert slope.slope == pytest.approx(power, abs=1e-12) and slope.intercept == pytest.approx(
            math.log(3 * factor**power), abs=1e-10
        )
        assert slope.spread < 1e-10 and slope.by == by and not slope.flattens
    assert ("steeper" in fit_slope(curve(lambda n: 3 * n**power)).says) == (power < -0.5)


def test_a_slope_is_called_other_than_that_of_independent_samples_only_where_that_is_clear():
    """Four points that scatter, and the same without scatter."""

    def says(power, scatter):
        wobble = iter((scatter, -scatter, -scatter, scatter))
        return fit_slope(curve(lambda n: n**power * math.exp(next(wobble)), 8)).says

    for scatter in (0.0, 0.05):
        assert ": as of independent samples (-0.5)" in says(-0.5, scatter)
    # certain, and too small a difference to speak of: it is not called the same
    assert ": next to that of independent samples (-0.5), but not it" in says(-0.51, 0.0)
    # Student's t with two degrees of freedom is above 7 in 1 of 100 cases
    assert ": steeper than independent" in says(-0.58, 0.0) and ": not to be told from that of independent" in says(
        -0.58, 0.05
    )
    assert ": a little slower than independent" in says(
        -0.45, 0.0
    ) and ": not to be told from that of independent" in says(-0.45, 0.05)
    assert ": slower than independent" in says(-0.35, 0.0)


def test_slope_and_spread_are_those_of_nested_independent_samples():
    """400 renders. Their slopes have a mean of -0.5 (4 standard errors), and z = (slope + 0.5) / spread is Student's t
    with 9 degrees of freedom: its variance is 9 / 7, that variance's relative deviation over 400 draws sqrt((kurtosis -
    1) / 400) with kurtosis 4.2."""
    slopes = [fit_slope(measured(seed)) for seed in range(400)]
    values, spreads = np.array([s.slope for s in slopes]), np.array([s.spread for s in slopes])
    # log of a mean square over 1000 pixels is low by 1 / 1000 at every n, which leaves the slope
    assert abs(values.mean() + 0.5) < 4 * values.std(ddof=1) / 20 < 0.001
    assert np.square((values + 0.5) / spreads).mean() == pytest.approx(9 / 7, rel=4 * math.sqrt(3.2 / 400))


def test_independent_renders_are_pooled():
    """Sixteen curves one after the other: one sixteenth of the variance. s is of 174 degrees of freedom: 5.4 %
    deviation, here times 4.
    """
    one, many = (
        [fit_slope(measured(seed)) for seed in range(16)],
        fit_slope([p for seed in range(16) for p in measured(seed)]),
    )
    assert many.slope == pytest.approx(np.mean([s.slope for s in one]), abs=1e-3)
    assert many.spread == pytest.approx(math.sqrt(np.mean([s.spread**2 for s in one]) / 16), rel=0.22)
    # mixed by samples it is not known which belongs to which; some slope is found nonetheless
    same = fit_slope([p for n in (1, 4, 16) for p in (point(n, 1.1 * n**-0.5), point(n, n**-0.5 / 1.1))])
    assert same.slope == pytest.approx(-0.5, abs=0.05) and math.isfinite(same.spread)


def test_too_few_points_are_said():
    assert (
        fit_slope([]) is None
        and fit_slope([point(1, 1.0)]) is None
        and fit_slope([point(4, 1.0), point(4, 2.0)]) is None
    )
    assert fit_slope([point(1, 0.0), point(2, 1.0), point(4, 1.0, seconds=0.0)], by="seconds") is None
    two = fit_slope([point(1, 1.0), point(4, 0.5)])
    assert two.slope == pytest.approx(-0.5) and math.isnan(two.spread) and "two points" in two.says and not two.flattens
    with pytest.raises(ValueError, match="hours"):
        fit_slope([], by="hours")


# --- flattening


def test_unbiased_curves_are_not_flagged():
    """A false alarm has a chance of 1 in 1000: of 500, more than 4 have a chance below 2e-4 (Poisson with mean 0.5)."""
    assert sum(fit_slope(measured(seed, 256)).flattens for seed in range(500)) <= 4


def test_unbiased_curves_of_uneven_samples_are_not_flagged():
    """Lognormal ones, with a kurtosis of 114. Of 100, more than 2 have a chance below 2e-4 (Poisson with mean 0.1)."""

    def draw(random, count):
        return (random.lognormal(0, 1, (count, PIXELS)) - math.exp(0.5)).sum(axis=0)

    assert sum(fit_slope(measured(seed, 256, draw=draw)).flattens for seed in range(100)) <= 2


@pytest.mark.parametrize("bias", [0.1, 0.3, 3.0])
def test_a_bias_is_flagged_and_its_size_said(bias):
    """At 256 samples the noise is 1/16; the RMSE of the bias is sqrt(2) times `bias`, so at least twice that."""
    for seed in range(50):
        slope = fit_slope(measured(seed, 256, bias))
        assert slope.flattens and "flattens" in slope.says and "bias" in slope.says
        assert slope.last_slope > -0.35


def test_the_spread_of_the_last_slope_has_the_noise_of_the_reference_in_it():
    """What is left when it is subtracted varies as before, and is less. z = (slope + 0.5) / spread of 200 renders has a
    mean square near 1: 4 deviations of chi-squared are allowed. That the spread is never taken as smaller than pixels
    tell makes it a little less."""
    slopes = [fit_slope(measured(seed, 1024, noise=1 / 8)) for seed in range(200)]
    z = np.array([(slope.last_slope + 0.5) / slope.last_spread for slope in slopes])
    assert np.square(z).mean() == pytest.approx(1, abs=4 * math.sqrt(2 / 200))


def test_light_that_no_path_found_is_distinguished_from_a_bias():
    """A picture that stays black has an error that stays, and nothing tells why. Nor is a slope that is not known that
    of anything.
    """

    def draw(chance):
        return lambda random, count: random.binomial(count, chance, PIXELS) / chance - count

    black = fit_slope(measured(1, 256, draw=draw(1e-9)))
    assert black.flattens and "a bias, or light that no path found yet" in black.says
    for seed in range(20):
        few = fit_slope(measured(seed, 256, draw=draw(3e-5)))
        assert "as of independent" not in few.says or abs(few.slope + 0.5) <= 0.015
    assert "or light" not in fit_slope(measured(1, 256, bias=0.3)).says


def test_a_bias_is_distinguished_from_noise_of_the_reference():
    """The reference has the noise of 64 samples: the curve flattens there, but not above what the reference adds.

    Seven points stand out, or six: Student's t with 4 degrees of freedom is above 17 in 1 of 14,000 cases.
    """
    t_tail = 17
    for seed in range(50):
        noisy = measured(seed, 1024, noise=1 / 8)
        slope = fit_slope(noisy)
        assert not slope.flattens and "come to the noise of the reference" in slope.says
        assert abs(slope.slope + 0.5) < t_tail * slope.spread  # it is the render's own
        assert fit_slope(measured(seed, 1024, noise=1 / 8, floor=0.0)).flattens  # so it is what the floor explains
        assert fit_slope(measured(seed, 1024, bias=0.3, noise=1 / 8)).flattens
    unknown = fit_slope(
        [
            ErrorPoint(seconds=p.seconds, seconds_total=0, samples=p.samples, rays={}, rmse=p.rmse, relmse=p.relmse)
            for p in measured(0, 1024, bias=0.3)
        ]
    )
    assert unknown.flattens and "not known" in unknown.says


def test_a_curve_that_bends_but_stays_steep_is_no_bias():
    """Low-discrepancy samples begin steep, and where edges decide become less so."""
    bent = fit_slope(curve(lambda n: 1 / n + 0.05 * n**-0.6, 4096))
    assert not bent.flattens and bent.slope < -0.6 and "steeper" in bent.says


def test_halves_cannot_show_a_bias():
    slope = fit_slope(curve(lambda n: math.hypot(n**-0.5, 0.3), from_halves=True))
    assert not slope.flattens
    assert "cannot show a bias" in fit_slope(curve(lambda n: n**-0.5 * (1 + 0.01 * math.sin(n)), from_halves=True)).says


def test_students_t_is_that_of_the_tables():
    """Abramowitz and Stegun, table 26.10: the points that are exceeded with a chance of 5 % and 0.5 %."""
    table = (
        (1, 6.314, 63.657),
        (2, 2.920, 9.925),
        (3, 2.353, 5.841),
        (4, 2.132, 4.604),
        (9, 1.833, 3.250),
        (30, 1.697, 2.750),
    )
    for freedom, five, half in table:
        assert t_exceeds(five, freedom) == pytest.approx(0.05, rel=2e-3) and t_exceeds(half, freedom) == pytest.approx(
            0.005, rel=2e-3
        )
        assert t_exceeds(0, freedom) == pytest.approx(0.5) and t_exceeds(-five, freedom) == pytest.approx(
            0.95, rel=1e-3
        )
    assert t_exceeds(1.645, 1000) == pytest.approx(0.05, rel=5e-3)


# --- time and efficiency


def test_the_time_to_an_error_that_was_reached_lies_between_points():
    points = curve(lambda n: n**-0.5)  # relmse = 1 / (2 n), seconds = n / 100
    for target in (0.5, 0.3, 0.01, 1 / 2048):
        assert time_to(points, target) == (pytest.approx(1 / (200 * target), rel=1e-12), False)
    assert time_to(points, 0.6) == (0.01, False)
    assert time_to(list(reversed(points)), 0.3)[0] == pytest.approx(1 / 60)


def test_the_time_to_an_error_that_was_not_reached_is_extrapolated():
    points = curve(lambda n: n**-0.5)
    seconds, extrapolated = time_to(points, 1e-6)
    assert extrapolated and seconds == pytest.approx(5000, rel=1e-9)
    for slope in (-0.5, fit_slope(points), fit_slope(points, "seconds")):
        assert time_to(points, 1e-6, slope) == (pytest.approx(5000, rel=1e-9), True)
    # relMSE falls with the square: with -0.75, from 1/2048 to 1e-6 in 488.28^(2/3) times the samples
    assert time_to(points, 1e-6, -0.75)[0] == pytest.approx(10.24 * (1e6 / 2048) ** (2 / 3), rel=1e-9)
    assert time_to(points[:1], 0.05) == (pytest.approx(0.1), True)
    # what was spent once, before the first sample, is not spent again with each
    late = [point(n, n**-0.5, seconds=50 + n / 100) for n in geometric_samples(1024)]
    assert time_to(late, 1e-6)[0] == pytest.approx(50 + 5000, rel=1e-9)


def test_the_noise_of_the_reference_is_part_of_the_target():
    """relMSE is 1 / (2 n) and the reference's 5e-5."""
    points = [point(n, math.hypot(n**-0.5, 0.01), floor=0.01) for n in geometric_samples(1024)]
    assert time_to(points, 1e-4) == (pytest.approx(100, rel=1e-9), True)


def test_an_error_that_is_never_reached_has_no_time():
    assert time_to([], 0.1) is None
    assert time_to(curve(lambda n: math.hypot(n**-0.5, 0.3)), 1e-6) is None  # a bias
    assert time_to(curve(lambda n: n**-0.5, floor=0.01), 5e-5) is None  # the reference's own noise
    assert time_to(curve(lambda n: n**-0.5), 1e-6, 0.1) is None
    assert time_to(curve(lambda n: n**-0.5), 1e-300, -0.01) is None
    with pytest.raises(ValueError, match="above 0"):
        time_to(curve(lambda n: n**-0.5), 0.0)


def test_efficiency_is_the_median_of_points_and_does_not_depend_on_samples():
    assert efficiency(curve(lambda n: 2 * n**-0.5)) == pytest.approx(100 / 4)
    assert efficiency(curve(lambda n: 2 * n**-0.5), "relmse") == pytest.approx(100 / 2)
    assert efficiency([point(1, 1.0, seconds=0.0), point(1, 1.0), point(1, 2.0), point(1, 9.0)]) == pytest.approx(25)
    spots = [dataclasses.replace(point(n, 2 * n**-0.5), relmse_cut=1 / n) for n in geometric_samples(1024)]
    assert efficiency(spots, "relmse_most") == pytest.approx(100) and efficiency(spots, "relmse") == pytest.approx(50)
    assert efficiency(curve(lambda n: 2 * n**-0.5), "relmse_most") == pytest.approx(50)  # not known: relMSE as it is
    assert efficiency([]) is None and efficiency([point(4, 0.1, floor=0.05)]) is None
    with pytest.raises(ValueError, match="flip"):
        efficiency([], "flip")
