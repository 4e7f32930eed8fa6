"""The question asked first: at equal time, how many times the error of the first setting each other one has."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from raybatch_addon.core.convergence.points import ErrorPoint


@dataclass(frozen=True)
class EqualTime:
    """The error of a setting over that of the first one, both at `seconds` of rendering."""

    label: str
    first: str  # the label of the first setting
    seconds: float  # at the end of whichever run ended first
    ratio: float  # of relMSE in which no pixel counts for more than `RELMSE_MOST`: the median of runs of one seed
    least: float
    most: float

    @property
    def says(self) -> str:
        """The comparison in one line."""
        times = "as much error as" if 0.995 <= self.ratio < 1.005 else f"{self.ratio:.3g} times the error of"
        runs = "" if self.least == self.most else f" ({self.least:.2g} to {self.most:.2g} in single runs)"
        return f"at equal time ({self.seconds:.3g} s) {self.label} has {times} {self.first}{runs}"

    def data(self) -> dict[str, Any]:
        """The values as JSON holds them, with six digits."""
        values = {name: getattr(self, name) for name in ("seconds", "ratio", "least", "most")}
        return {"label": self.label, "first": self.first, **{name: float(f"{x:.6g}") for name, x in values.items()}}


def equal_times(curves: dict[str, dict[int, Sequence[ErrorPoint]]]) -> list[EqualTime]:
    """Each setting but the first beside the first; `curves` are the points of runs by label, then by seed. Left out is
    what has no error or no time in common with the first.
    """
    labels = list(curves)
    found = []
    for label in labels[1:]:
        pairs = [(points, other) for seed, points in curves[label].items() if (other := curves[labels[0]].get(seed))]
        usable = [pair for pair in pairs if all(_timed(points) for points in pair)]
        if not usable:
            continue
        seconds = min(_timed(points)[-1].seconds for pair in usable for points in pair)
        errors = [tuple(error_at(points, seconds) for points in pair) for pair in usable]
        ratios = [ours / first for ours, first in errors if ours is not None and first]
        if ratios:
            found.append(EqualTime(label, labels[0], seconds, statistics.median(ratios), min(ratios), max(ratios)))
    return found


def error_at(points: Sequence[ErrorPoint], seconds: float) -> float | None:
    """The error at `seconds`, relMSE in which no pixel counts for more than `RELMSE_MOST`: between two points along a
    straight line in logarithms; None before the first and beyond the last.
    """
    curve = _timed(points)
    if not curve or not curve[0].seconds <= seconds <= curve[-1].seconds:
        return None
    before = curve[0]
    for point in curve:
        if point.seconds >= seconds:
            if point.seconds == before.seconds:
                return point.relmse_most
            share = math.log(seconds / before.seconds) / math.log(point.seconds / before.seconds)
            return before.relmse_most * (point.relmse_most / before.relmse_most) ** share
        before = point
    return None


def _timed(points: Sequence[ErrorPoint]) -> list[ErrorPoint]:
    return sorted((each for each in points if each.seconds > 0 and each.relmse_most > 0), key=lambda each: each.samples)
