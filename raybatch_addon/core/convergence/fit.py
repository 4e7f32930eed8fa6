"""Findings from a curve of errors: its slope, whether it flattens, when it reaches a target, and what an error costs.

**Model.** The squared error of an unbiased estimator with independent samples falls as 1 / n, whatever the scene, so
that RMSE has slope -0.5 in log(RMSE) against log(n); low-discrepancy samples are steeper. A bias b adds b^2, which
stays: the curve flattens.

**Uncertainty.** Pictures of one render are nested: that of n samples is part of that of m > n. Their errors then
correlate as sqrt(n / m), and squares of normal variables as the square of that, so that the deviations of log(RMSE)
from its line have covariances s^2 n / m. The fit is by generalised least squares with these; s is estimated from the
residuals (Student's t). Points that begin again at fewer samples belong to another, independent render.

A curve that bends does not fit a line, and its residuals give too large an s to test the bend with. Points that know
how their error varies from pixel to pixel (`rmse_spread`) bring a better measure. Let r(n) be the variance of the mean
squared error of n samples, relative to its square. The error of m samples is n / m times that of n and an independent
rest without bias, so that the covariance of the two relative deviations is r(n) n / m: exactly, for errors of any
distribution. Few pixels do not show their own rare errors: where points scatter more than that about a cubic, which
follows any bend, r is raised to what they show.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import ErrorPoint, known

# Slope of log(RMSE) against log(samples) of independent samples
INDEPENDENT_SLOPE = -0.5
# Chance of a false alarm, when a curve that does not flatten is tested
FALSE_ALARM = 1e-3
# Chance with which independent samples are called steeper or a little slower than they are
OTHER_CHANCE = 0.01
# Nor by less than this: points of one run follow from each other, so that slopes spread a little more than their fit
# says
OTHER_MARGIN = 0.015
# Slopes closer than this are taken as the same, however certain the difference: a line is a model, and at few samples
# pixels that rarely find their light make curves bend a little
SLOPE_MARGIN = 0.1
# A curve is tested where the reference's noise is at most this share of the squared error; there it is subtracted
FLOOR_SHARE = 0.5
# Points above the floor that a test needs: three unknowns (a slope either side of the middle, and a level), and some to
# estimate the spread
POINTS_TO_TEST = 6
# Degrees of freedom where the spread is known: Student's t is normal there
FREEDOM_KNOWN = 1000
# Efficiencies are of points in which the reference's noise is at most this share of the squared error
EFFICIENCY_FLOOR_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Slope:
    """The line through a curve of errors: log(RMSE) = intercept + slope log(x), natural logarithms."""

    slope: float
    intercept: float
    spread: float  # standard error of `slope`; NaN where two points leave nothing to estimate it
    flattens: bool  # the error stops falling above the reference's noise: a bias
    says: str  # all this in words
    by: str = "samples"  # what x is: "samples" or "seconds"
    # of the curve's last half, against samples, without the reference's noise; None: few points
    last_slope: float | None = None
    last_spread: float | None = None  # standard error of `last_slope`


def slope_data(slope: Slope | None) -> dict[str, Any]:
    """For JSON; None is what is not known."""
    if slope is None:
        return dict.fromkeys(("slope", "slope_spread", "flattens", "says"))
    return {
        "slope": known(slope.slope),
        "slope_spread": known(slope.spread),
        "flattens": slope.flattens,
        "says": slope.says,
    }


def fit_slope(points: Sequence[ErrorPoint], by: str = "samples") -> Slope | None:
    """The line through `points` (of one render, or of several one after the other) against `by` (samples, seconds);
    None below two.

    Points without error (0) or, against seconds, without time are left out. So that the slope is the render's own, the
    known noise of the reference is subtracted, and points in which it is more than half of the squared error are left
    out (unless that leaves too few).

    `flattens` is tested against samples, on points whose error stands out from the reference's noise: two lines that
    meet in the middle of the curve are fitted. A bias is reported where the last is shallower than -0.5, which no
    unbiased estimator stays above, and either shallower than the first or next to level; each by more than 0.1 and with
    a chance of a false alarm of 1 in 1000 (measured: 6 in 4000 curves of 50 normal pixels, none of 4000 of 200, but 2
    in 100 of 50 lognormal ones with a kurtosis of 9e6). A curve that is level from the beginning may have a bias, or no
    path found the light yet: it is flagged, and both are said. Estimates from halves of a render cannot show a bias: it
    is in both.
    """
    if by not in ("samples", "seconds"):
        raise ValueError(f"errors are fitted against samples or seconds, not {by!r}")
    usable = [p for p in points if p.rmse > 0 and p.samples > 0 and getattr(p, by) > 0]
    used, errors = _above_floor(usable)
    if _spread_out(used, by) < 2:
        used, errors = usable, [p.rmse for p in usable]
    if _spread_out(used, by) < 2:
        return None
    x = np.log([getattr(p, by) for p in used])
    line = _fit(np.column_stack([np.ones(len(used)), x]), np.log(errors), _nesting(used))
    (intercept, slope), spread = line.values, line.spreads[1]
    bend = _bend(usable)
    says = _in_words(slope, spread, line.freedom, usable, bend) if by == "samples" else _in_seconds(slope, spread)
    return Slope(
        slope=float(slope),
        intercept=float(intercept),
        spread=float(spread),
        flattens=bend is not None and bend.is_bias,
        says=says,
        by=by,
        last_slope=bend.last if bend else None,
        last_spread=bend.last_spread if bend else None,
    )


def time_to(
    points: Sequence[ErrorPoint], target: float, slope: Slope | float | None = None
) -> tuple[float, bool] | None:
    """Seconds of rendering at which the relMSE of one render reaches `target`, and whether that is extrapolated; None:
    never at this rate.

    The noise of the reference is part of the error, here and in the target. Between points error and time are taken as
    straight in logarithms. Beyond the last, the error falls with `slope` (of RMSE against
    samples, or a `Slope` by either; default: fitted to the points, and -0.5 for one point), and each sample takes as
    long as the last ones did. Never: the curve flattens, does not fall, or the target is below the noise of the
    reference.
    """
    if not target > 0:
        raise ValueError(f"the error to reach must be above 0, and is {target}")
    curve = sorted((p for p in points if p.relmse > 0 and p.seconds > 0), key=lambda p: p.samples)
    if not curve:
        return None
    before = None
    for point in curve:
        if point.relmse <= target:
            if before is None:
                return point.seconds, False
            share = math.log(target / before.relmse) / math.log(point.relmse / before.relmse)
            return before.seconds * (point.seconds / before.seconds) ** share, False
        before = point
    last = curve[-1]
    floor = last.floor_relmse or 0.0
    if target <= floor:
        return None
    fitted = fit_slope(curve) if slope is None else slope
    by = fitted.by if isinstance(fitted, Slope) else "samples"
    if isinstance(fitted, Slope) and fitted.flattens:
        return None
    rate = INDEPENDENT_SLOPE if fitted is None else fitted.slope if isinstance(fitted, Slope) else float(fitted)
    if not rate < 0:
        return None
    own = last.relmse - floor  # where that is noise, no more than the reference's share is taken off
    power = math.log((target - floor) / max(own, (1 - FLOOR_SHARE) * last.relmse)) / (2 * rate)
    if power <= 0:  # chance had it that the last error is above what its own noise and the floor make
        return last.seconds, True
    if power > 700:  # beyond float64, and beyond anybody's time
        return None
    factor = math.exp(power)
    if by == "seconds":
        return last.seconds * factor, True
    return last.seconds + last.samples * (factor - 1) * _seconds_per_sample(curve), True


def efficiency(points: Sequence[ErrorPoint], metric: str = "rmse") -> float | None:
    """1 / (error^2 x seconds), the median over points; None where no point gives it. Constant in n for independent
    samples.

    `metric` is "rmse", "relmse" (a square already), or "relmse_most", which a few bright pixels do not rule. Points
    with no time yet are left out, and those in which the noise of the reference is more than a tenth of the squared
    error: it would count as theirs. For samples that converge faster it grows with the time, so compare settings over
    the same range.
    """
    if metric not in ("rmse", "relmse", "relmse_most"):
        raise ValueError(f"an efficiency is of rmse, relmse or relmse_most, not {metric!r}")
    power, of_floor = (2, "floor_rmse") if metric == "rmse" else (1, "floor_relmse")
    costs = []
    for point in points:
        squared, floor = getattr(point, metric) ** power, (getattr(point, of_floor) or 0.0) ** power
        if point.seconds > 0 and squared > 0 and floor <= EFFICIENCY_FLOOR_SHARE * squared:
            costs.append(squared * point.seconds)
    return 1 / statistics.median(costs) if costs else None


# --- least squares


def _above_floor(points: Sequence[ErrorPoint]) -> tuple[list[ErrorPoint], list[float]]:
    """The points that stand out from the reference's noise, and their RMSE without it (all, as they are, where it is
    not known).
    """
    clear = [p for p in points if (p.floor_rmse or 0.0) ** 2 <= FLOOR_SHARE * p.rmse**2]
    return clear, [math.sqrt(p.rmse**2 - (p.floor_rmse or 0.0) ** 2) for p in clear]


def _spread_out(points: Sequence[ErrorPoint], by: str) -> int:
    """At how many places there are points."""
    return len({getattr(p, by) for p in points})


@dataclass(frozen=True)
class _Line:
    values: np.ndarray  # of the columns
    covariance: np.ndarray  # of the values
    freedom: int  # points less values

    @property
    def spreads(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def _nesting(points: Sequence[ErrorPoint]) -> np.ndarray:
    """Correlation of the points' deviations: n / m for n < m samples of one render, 0 between renders."""
    samples = np.array([p.samples for p in points], np.float64)
    render = np.cumsum(np.diff(samples, prepend=samples[0]) < 0)
    smaller, larger = np.minimum.outer(samples, samples), np.maximum.outer(samples, samples)
    # points of one sample count in a row are of as many renders, or the matrix would be singular
    again = np.cumsum(np.diff(samples, prepend=samples[0] - 1) == 0)
    apart = (render[:, None] != render) | (again[:, None] != again)
    return np.where(apart, 0.0, smaller / larger)


def _measured_covariance(points: Sequence[ErrorPoint], errors: Sequence[float]) -> np.ndarray | None:
    """Covariances of log(RMSE) as pixels give them; None where a point has no pixels, or too few for a matrix that can
    be one.
    """
    spreads = [p.rmse_spread for p in points if p.rmse_spread]
    if len(spreads) < len(points):
        return None
    # without the floor the same deviation of the squared error is a larger share of it
    relative = np.array([spread * p.rmse / error**2 for spread, p, error in zip(spreads, points, errors)]) ** 2
    samples = np.array([p.samples for p in points])
    covariance = _nesting(points) * np.where(samples[:, None] <= samples, relative[:, None], relative)
    if np.linalg.eigvalsh(covariance)[0] < 1e-6 * relative.max():
        return None
    x = np.log(samples / samples.min())
    root = np.linalg.cholesky(covariance)
    a, b = np.linalg.solve(root, x[:, None] ** np.arange(4)), np.linalg.solve(root, np.log(errors))
    scatter = np.square(b - a @ np.linalg.lstsq(a, b, rcond=None)[0]).sum() / (len(points) - 4)
    return covariance * max(1.0, scatter)


def _fit(columns: np.ndarray, y: np.ndarray, correlation: np.ndarray, covariance: np.ndarray | None = None) -> _Line:
    """Generalised least squares; with a `covariance` that is known the residuals need not give it.

    Covariances of the values are NaN where no point is left to estimate the spread.
    """
    root = np.linalg.cholesky(correlation if covariance is None else covariance)
    a, b = np.linalg.solve(root, columns), np.linalg.solve(root, y)
    values, *_ = np.linalg.lstsq(a, b, rcond=None)
    if covariance is not None:
        return _Line(values, np.linalg.pinv(a.T @ a), FREEDOM_KNOWN)
    freedom = len(y) - columns.shape[1]
    variance = np.square(b - a @ values).sum() / freedom if freedom > 0 else math.nan
    return _Line(values, variance * np.linalg.pinv(a.T @ a), freedom)


@dataclass(frozen=True, kw_only=True)
class _Bend:
    first: float  # slope of the first half
    last: float  # and of the last
    last_spread: float
    bias: float  # RMSE that is left at the end
    is_bias: bool
    is_level: bool  # from the beginning, as far as can be seen: it did not fall, so that it did not stop falling either
    floor_known: bool


def _bend(points: Sequence[ErrorPoint]) -> _Bend | None:
    """Two lines that meet in the middle, fitted to the error without the reference's noise; None: too few points stand
    out from it.
    """
    if any(p.from_halves for p in points):
        return None
    used, errors = _above_floor(points)
    x, y = np.log([p.samples for p in used]), np.log(errors)
    if len(used) < POINTS_TO_TEST or len(np.unique(x)) < POINTS_TO_TEST:
        return None
    middle = (x.min() + x.max()) / 2
    late = np.maximum(x - middle, 0)
    line = _fit(
        np.column_stack([np.ones(len(x)), np.minimum(x, middle), late]),
        y,
        _nesting(used),
        _measured_covariance(used, errors),
    )
    (_, first, last), spread = line.values, line.spreads
    bend_spread = math.sqrt(max(line.covariance[1, 1] + line.covariance[2, 2] - 2 * line.covariance[1, 2], 0.0))
    slow = _is_above(last - INDEPENDENT_SLOPE, spread[2], line.freedom)
    bent = _is_above(last - first, bend_spread, line.freedom)
    level = last > -SLOPE_MARGIN
    left = np.square([error for error, at in zip(errors, x) if at == x.max()])
    known = all(p.floor_rmse is not None for p in points)
    is_bias = bool(slow and (bent or level))
    return _Bend(
        first=float(first),
        last=float(last),
        last_spread=float(spread[2]),
        bias=math.sqrt(np.mean(left)),
        is_bias=is_bias,
        is_level=is_bias and not bent,
        floor_known=known,
    )


def _is_above(difference: float, spread: float, freedom: int) -> bool:
    """Whether `difference` is above `SLOPE_MARGIN`, and above 0 beyond chance."""
    return difference > SLOPE_MARGIN and (spread == 0 or t_exceeds(difference / spread, freedom) < FALSE_ALARM)


def t_exceeds(t: float, freedom: int) -> float:
    """The chance that Student's t with `freedom` degrees of freedom is above `t` (Abramowitz and Stegun, 26.7.3 and
    26.7.4).
    """
    angle = math.atan(t / math.sqrt(freedom))
    sine, cosine = math.sin(angle), math.cos(angle)
    odd = freedom % 2
    term = cosine if odd else 1.0
    total = 0.0 if odd and freedom == 1 else term
    for k in range(3 if odd else 2, freedom - 1, 2):
        term *= cosine * cosine * (k - 1) / k
        total += term
    inside = 2 / math.pi * (angle + sine * total) if odd else sine * total
    return (1 - inside) / 2


def _seconds_per_sample(curve: Sequence[ErrorPoint]) -> float:
    """The value for the last samples; for all where one point, or a clock that stood still, leaves no other."""
    last = curve[-1]
    for before in reversed(curve[:-1]):
        if before.samples <= last.samples / 2 and before.seconds < last.seconds:
            return (last.seconds - before.seconds) / (last.samples - before.samples)
    return last.seconds / last.samples


def _in_seconds(slope: float, spread: float) -> str:
    return f"RMSE falls as seconds^{slope:.2f}" + (f" (± {spread:.2f})" if math.isfinite(spread) else "")


def _in_words(slope: float, spread: float, freedom: int, points: Sequence[ErrorPoint], bend: _Bend | None) -> str:
    """What the slope against samples means."""
    measured = f"slope {slope:.2f}" + (f" ± {spread:.2f}" if math.isfinite(spread) else "")
    if bend and bend.is_bias:
        why = "a bias" + ", or light that no path found yet" * bend.is_level
        if not bend.floor_known:
            why += ", or noise of the reference, whose own error is not known"
        return (
            f"{measured}: the curve flattens (slope {bend.last:.2f} at its end); {why}: about {bend.bias:.3g} "
            "(RMSE) is left"
        )
    clear = len(_above_floor(points)[0])
    notes = ""
    if clear < len(points):
        notes += f"; {len(points) - clear} of {len(points)} points come to the noise of the reference"
    if all(p.from_halves for p in points):
        notes += "; an estimate from halves cannot show a bias"
    if not freedom:
        return f"{measured}: of two points, which tell no spread{notes}"
    if _is_above(slope - INDEPENDENT_SLOPE, spread, freedom):
        why = (
            "light that is rarely found, or too few points to tell a bias"
            if clear > 1
            else "it has come to the noise of the reference"
        )
        return f"{measured}: slower than independent samples (-0.5): {why}{notes}"
    steeper = INDEPENDENT_SLOPE - slope
    chance = 0.0 if spread == 0 else t_exceeds(abs(steeper) / spread, freedom)
    if chance >= OTHER_CHANCE:
        same = "as of" if abs(steeper) <= OTHER_MARGIN else "not to be told from that of"
        return f"{measured}: {same} independent samples (-0.5){notes}"
    if abs(steeper) <= OTHER_MARGIN:
        return f"{measured}: next to that of independent samples (-0.5), but not it{notes}"
    other = "steeper" if steeper > 0 else "a little slower" if -steeper <= SLOPE_MARGIN else "slower"
    return f"{measured}: {other} than independent samples (-0.5){notes}"
