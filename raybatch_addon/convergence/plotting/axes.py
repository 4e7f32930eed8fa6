"""Logarithmic axes: ranges, ticks and their labels; and the frame of a plot with a grid."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .raster import Canvas, Color, text_width

# Labels of ticks within a decade, as many as there is room for: (mantissas, labelled)
_MANTISSAS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), tuple(float(m) for m in range(1, 10)))
# Prefixes of numbers from a thousand to beyond a billion
_PREFIXES = {3: "k", 6: "M", 9: "G", 12: "T"}


@dataclass(frozen=True)
class LogAxis:
    """Numbers `low` to `high`, both above 0, along pixels `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    @staticmethod
    def around(
        values: Iterable[float], start: float, end: float, least_span: float = 4.0, margin: float = 0.04
    ) -> LogAxis:
        """An axis on which all positive finite `values` lie, with `margin` of its length either side; high / low is at
        least `least_span`.
        """
        usable = [v for v in values if v > 0 and math.isfinite(v)] or [1.0]
        low, high = math.log(min(usable)), math.log(max(usable))
        extra = max(math.log(least_span) - (high - low), 0) / 2
        extra += (high - low + 2 * extra) * margin
        return LogAxis(math.exp(max(low - extra, -700)), math.exp(min(high + extra, 700)), start, end)

    def at(self, value: float) -> float:
        """The pixel of `value`; of 0 and less the start."""
        if value <= 0:
            return self.start
        return self.start + (self.end - self.start) * math.log(value / self.low) / math.log(self.high / self.low)

    def ticks(self, room: float) -> list[float]:
        """Round numbers on the axis, at least `room` pixels apart: as many as there can be."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        best: list[float] = []
        for mantissas in _MANTISSAS:
            ticks = self._inside(m * 10.0**d for d in decades for m in mantissas)
            if self._apart(ticks) >= room and len(ticks) > len(best):
                best = ticks
        step = 2
        while not best and step <= 16:  # too many decades for a label each
            best = self._inside(10.0**d for d in decades if d % step == 0)
            if self._apart(best) < room:
                best = []
            step *= 2
        return best

    def time_ticks(self, room: float) -> list[float]:
        """Ticks of seconds: round in the units that `seconds_text` names them with."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        first = (
            [10.0**d for d in decades if d < 2]
            + [60.0, 600.0, 3600.0, 36_000.0]
            + [86400.0 * 10.0**d for d in range(9)]
        )
        more = [m * 10.0**d for d in decades if d < 1 for m in (2, 5)] + [20.0, 120.0, 300.0, 1200.0, 7200.0, 18_000.0]
        ticks: list[float] = []
        for values in (first, more):
            for value in self._inside(values):
                if all(abs(self.at(value) - self.at(other)) >= room for other in ticks):
                    ticks.append(value)
        return sorted(ticks)

    def small_ticks(self) -> list[float]:
        """1 to 9 times every power of ten; those alone where there are many."""
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        mantissas = range(1, 10) if len(decades) <= 9 else (1,)
        return self._inside(m * 10.0**d for d in decades for m in mantissas)

    def _inside(self, values: Iterable[float]) -> list[float]:
        return [v for v in values if self.low <= v <= self.high]

    def _apart(self, ticks: Sequence[float]) -> float:
        places = [self.at(t) for t in ticks]
        return min([abs(b - a) for a, b in itertools.pairwise(places)], default=math.inf)


def number_text(value: float) -> str:
    """A tick's label: 0.001 to 999 as they are, above with k, M, G, T, below as 1e-4."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    power = math.floor(math.log10(abs(value)) + 1e-9)
    if power < -3 or power >= 15:
        return f"{value / 10.0**power:.3g}e{power}"
    prefix = max((p for p in _PREFIXES if p <= power), default=0)
    return f"{value / 10.0**prefix:.3g}{_PREFIXES.get(prefix, '')}"


def seconds_text(value: float) -> str:
    """A time with its unit: 20 ms, 1.5 s, 2 min, 3 h, 4 d."""
    for unit, name, below in (
        (1e-6, "us", 1e-3),
        (1e-3, "ms", 1.0),
        (1.0, "s", 60.0),
        (60.0, "min", 3600.0),
        (3600.0, "h", 86400.0),
    ):
        if value < below * (1 - 1e-9):
            return f"{value / unit:.3g} {name}"
    days = value / 86400
    return (
        f"{days:.3g} d"
        if days < 1000
        else f"{days / 365.25:.3g} years"
        if days < 36_500
        else f"{days / 365.25:,.0f} years"
    )


@dataclass(frozen=True)
class Style:
    """Colours and sizes [pixels] of a plot."""

    background: Color
    pane: Color
    grid: Color
    edge: Color
    text: Color
    dim_text: Color
    text_size: float  # height of a capital letter


def draw_frame(canvas: Canvas, x: LogAxis, y: LogAxis, style: Style, labelled_x: bool, y_label: str) -> None:
    """A pane with its grid, ticks and labels. `x` runs from left to right, `y` upwards."""
    size = style.text_size
    thin = line_width(size)
    canvas.rectangle(x.start, y.start, x.end, y.end, style.pane)
    for value in x.small_ticks():
        canvas.rectangle(x.at(value), y.start, round(x.at(value)) + thin, y.end, style.grid, 0.35)
    for value in y.small_ticks():
        canvas.rectangle(x.start, y.at(value), x.end, round(y.at(value)) + thin, style.grid, 0.35)
    for value in x.time_ticks(text_width("500 ms", size) + size):
        place = x.at(value)
        canvas.rectangle(place, y.start, round(place) + thin, y.end, style.grid)
        if labelled_x:
            canvas.rectangle(place, y.start - size / 2, round(place) + thin, y.start, style.edge)
            canvas.text(place, y.start - 2.2 * size, seconds_text(value), size, style.text, 0.5)
    for value in y.ticks(2.4 * size):
        place = y.at(value)
        canvas.rectangle(x.start, place, x.end, round(place) + thin, style.grid)
        canvas.rectangle(x.start - size / 2, place, x.start, round(place) + thin, style.edge)
        canvas.text(x.start - size, place - size / 2, number_text(value), size, style.text, 1.0)
    for x1, y1 in ((round(x.start) + thin, y.end), (x.end, round(y.start) + thin)):
        canvas.rectangle(x.start, y.start, x1, y1, style.edge)
    canvas.text(x.start, y.end + size * 0.7, y_label, size, style.dim_text)


def line_width(text_size: float) -> int:
    """Width of a grid's lines beside text of that size [whole pixels]: where the text can be read from afar, so can the
    grid.
    """
    return max(1, round(text_size / 6))
