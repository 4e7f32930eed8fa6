"""How dark pictures become where pixels end their sampling by what samples show: rules beside each other, simulated.

Every sample of every pixel is an exponential number of mean 0.1, and rarely a bright event more: all pixels are alike,
so that whatever a mean over many pictures lacks is bias. Halves, looks and noise are those of the engine.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable

import numpy as np

from raybatch_addon.core.wavefront.adaptive.looks import Looks
from raybatch_addon.core.wavefront.adaptive.noise import RADIUS
from studies.pages import table
from studies.study import Case, Report, Row

EDGE = 48  # pixels
PICTURES = 150  # of each rule, in each turn
MEAN = 0.1  # of what is not an event
SIMULATED = "simulated"
# Threshold, first look, samples at most, probability of an event, and its value
EVENTS = (
    (0.01, 64, 1024, 1e-4, 1000.0),
    (0.05, 40, 2048, 1e-3, 100.0),
    (0.1, 32, 2048, 1e-3, 100.0),
    (0.15, 32, 2048, 1e-3, 100.0),
    (0.1, 32, 1024, 1e-4, 1000.0),
)


def sample_noise(first: np.ndarray, second: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The noise of samples, like `noise.sample_noise`, for grey pixels, float64."""
    light = 1.5 * (first + second)
    ratio = np.divide(1.5 * np.abs(first - second), light, out=np.zeros_like(light), where=light > 0)
    return ratio**2 * np.minimum(light, 1.0) * count


def window_sums(values: np.ndarray) -> np.ndarray:
    """Sums over the neighbourhood of each pixel, itself included."""
    for _ in range(2):
        before = np.pad(values, ((RADIUS + 1, RADIUS), (0, 0))).cumsum(0)
        values = (before[2 * RADIUS + 1 :] - before[: -2 * RADIUS - 1]).T
    return values


def own(noise: np.ndarray) -> np.ndarray:
    """The pixel alone."""
    return noise


def with_own(noise: np.ndarray) -> np.ndarray:
    """The mean over the neighbourhood and the pixel."""
    return window_sums(noise) / window_sums(np.ones_like(noise))


def neighbours(noise: np.ndarray) -> np.ndarray:
    """The mean over the neighbourhood without the pixel: what the engine does."""
    return np.maximum(window_sums(noise) - noise, 0.0) / (window_sums(np.ones_like(noise)) - 1.0)


RULES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "the pixel itself": own,
    "the neighbourhood with the pixel": with_own,
    "the neighbours alone": neighbours,
}


def picture(
    rule: Callable, threshold: float, first: int, last: int, probability: float, value: float, seed: int
) -> tuple[float, float]:
    """Mean of one picture, and its mean samples."""
    random, looks = np.random.default_rng(seed), Looks(first)
    sums, counts = np.zeros((2, EDGE, EDGE)), np.zeros((EDGE, EDGE))
    active, done = np.ones((EDGE, EDGE), bool), 0
    while done < last and active.any():
        end = min(looks.after(done), last)
        more = (end - done) // 2
        found = MEAN * random.gamma(more, size=sums.shape) + value * random.binomial(more, probability, sums.shape)
        sums += np.where(active, found, 0.0)
        counts[active] = done = end
        one, other = sums / (counts / 2)
        noise = sample_noise(one, other, counts)
        active &= ~(rule(noise) < threshold**2 * done)
    return float((sums.sum(0) / counts).mean()), float(counts.mean())


def cases() -> list[Case]:
    """Every rule for every kind of event."""
    return [
        Case(f"{SIMULATED} {k + 1}: {rule}", f"{SIMULATED} {k + 1}", {"scene": SIMULATED, "variant": rule, "event": k})
        for k in range(len(EVENTS))
        for rule in RULES
    ]


def measured(case: Case, turn: int) -> Row:
    """Means of many pictures over the true one, their standard error, and mean samples."""
    threshold, first, last, probability, value = EVENTS[case.what["event"]]
    seeds, true = range(turn * PICTURES, (turn + 1) * PICTURES), MEAN + probability * value
    rule = RULES[case.what["variant"]]
    found = np.array([picture(rule, threshold, first, last, probability, value, seed) for seed in seeds])
    deviation = found[:, 0].std(ddof=1) / math.sqrt(PICTURES)
    return {"brightness": found[:, 0].mean() / true, "deviation": deviation / true, "samples_mean": found[:, 1].mean()}


def bias_table(report: Report) -> str:
    """Bias of every rule, with its standard error."""
    rows = []
    for k, (threshold, _, _, probability, value) in enumerate(EVENTS):
        for rule in RULES:
            mine = [row for row in report["rows"] if row.get("event") == k and row["variant"] == rule]
            if not mine:
                continue
            bias = 100 * (statistics.mean(row["brightness"] for row in mine) - 1)
            error = 100 * math.sqrt(sum(row["deviation"] ** 2 for row in mine)) / len(mine)
            samples = statistics.mean(row["samples_mean"] for row in mine)
            events = f"1 in {1 / probability:,.0f}"
            shown = f"{bias:+.2f} % ± {error:.2f} %"
            rows.append([f"{threshold:g}", events, f"{value:,.0f}", rule, f"{samples:.0f}", shown])
    return table(["threshold", "events", "value", "decided by", "mean samples", "bias"], rows)
