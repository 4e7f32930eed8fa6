"""The plot of the last renders: error and rays a second over the seconds of rendering, all logarithmic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .plotting.axes import LogAxis, Style, draw_frame, line_width
from .plotting.raster import Canvas, Color, line_height, text_width
from .records import RUNNING, Run
from .run_texts import names_of

# Colours of the slots: distinct for colour-blind eyes too, and light enough for a dark pane
SLOT_COLORS: tuple[Color, ...] = (
    (0.34, 0.71, 0.91),
    (0.96, 0.65, 0.14),
    (0.24, 0.80, 0.58),
    (0.94, 0.89, 0.35),
    (0.98, 0.50, 0.68),
    (0.74, 0.65, 1.0),
)
_BACKGROUND, _PANE, _GRID, _EDGE = (0.16, 0.16, 0.16), (0.10, 0.10, 0.10), (0.27, 0.27, 0.27), (0.55, 0.55, 0.55)
_TEXT, _DIM_TEXT = (0.90, 0.90, 0.90), (0.72, 0.72, 0.72)
# An extrapolation is shown as far as this many times the seconds that were measured, and a target this far below the
# errors
_AHEAD, _BELOW = 300.0, 300.0
# Share of the height that is the error's
_ERROR_SHARE = 0.63


def draw_plot(runs: Sequence[Run], target: float, width: int, height: int, text_size: float = 7.0) -> np.ndarray:
    """The plot of those of `runs` that are shown, newest first: RGBA as shown, float32, shape [height, width, 4],
    bottom row first.

    `target` is the relMSE to reach (0: none); `text_size` the height of a capital letter in pixels.
    """
    style = Style(_BACKGROUND, _PANE, _GRID, _EDGE, _TEXT, _DIM_TEXT, text_size)
    canvas = Canvas(width, height, _BACKGROUND)
    shown = [run for run in runs if run.shown]
    left, right = text_width("0.005", text_size) + 2.4 * text_size, width - 2 * text_size
    bottom, top, gap = 5.2 * text_size, height - 2.6 * text_size, 3.2 * text_size
    middle = bottom + (top - bottom - gap) * (1 - _ERROR_SHARE)
    x = LogAxis.around(_times(shown, target), left, right, 10.0)
    rates = LogAxis.around([r.rays_per_second for run in shown for r in run.rates], bottom, middle, 10.0, 0.08)
    errors = _error_axis(shown, target, x, middle + gap, top, text_size)
    draw_frame(canvas, x, errors, style, False, "error (relMSE, estimated)")
    draw_frame(canvas, x, rates, style, True, "rays a second")
    canvas.text((left + right) / 2, 0.9 * text_size, "time of rendering", text_size, _DIM_TEXT, 0.5)
    _draw_target(canvas, x, errors, target, style)
    for run in reversed(shown):  # the newest on top
        _draw_run(canvas, run, target, x, errors, rates, text_size)
    if not any(run.points for run in shown):
        text = (
            "no error yet"
            if any(run.estimates_error for run in shown)
            else "Error Estimate is off"
            if shown
            else "nothing recorded yet"
        )
        canvas.text((left + right) / 2, (errors.start + errors.end) / 2, text, text_size * 1.2, _DIM_TEXT, 0.5)
    _Legend.of(shown, x, text_size).draw(canvas, x, top, style)
    return canvas.pixels


def _times(runs: Sequence[Run], target: float) -> list[float]:
    times = []
    for run in runs:
        times += [p.seconds for p in run.points] + [p.seconds for p in run.rates]
        ahead = _extrapolated(run, target)
        if ahead:
            times.append(ahead)
    return times


def _errors(runs: Sequence[Run], target: float) -> list[float]:
    errors = [p.relmse for run in runs for p in run.points]
    if not errors:
        return [target, target * 1000] if target > 0 else [1.0]
    return errors + [target] * (min(errors) / _BELOW <= target <= max(errors) * _BELOW)


def _extrapolated(run: Run, target: float) -> float | None:
    """When the run would reach `target`, if that is worth showing."""
    found = run.time_to(target)
    if (
        found is None
        or not found[1]
        or found[0] > _AHEAD * run.points[-1].seconds
        or target < run.points[-1].relmse / _BELOW
    ):
        return None
    return found[0]


def _draw_target(canvas: Canvas, x: LogAxis, errors: LogAxis, target: float, style: Style) -> None:
    if not errors.low <= target <= errors.high:
        return
    size = style.text_size
    y = round(errors.at(target)) + line_width(size) / 2
    canvas.line([(x.start, y), (x.end, y)], _TEXT, line_width(size), dash=size, alpha=0.8)
    canvas.text(x.start + size, y + 0.6 * size, f"to reach: {target:g}", size, _TEXT)


def _draw_run(
    canvas: Canvas, run: Run, target: float, x: LogAxis, errors: LogAxis, rates: LogAxis, size: float
) -> None:
    color = SLOT_COLORS[run.slot % len(SLOT_COLORS)]
    width = max(size * 0.26, 1.2)
    points = [(x.at(p.seconds), errors.at(p.relmse)) for p in run.points if p.seconds > 0 and p.relmse > 0]
    pane = (x.start, errors.start, x.end, errors.end)
    canvas.line(points, color, width, clip=pane)
    for place in points:
        canvas.dot(*place, size * 0.36, color, pane)
    ahead = _extrapolated(run, target)
    if ahead and points:
        canvas.line([points[-1], (x.at(ahead), errors.at(target))], color, width, dash=size * 0.6, clip=pane, alpha=0.8)
        canvas.dot(x.at(ahead), errors.at(target), size * 0.5, color, pane)
    places = [(x.at(r.seconds), rates.at(r.rays_per_second)) for r in run.rates if r.rays_per_second > 0]
    pane = (x.start, rates.start, x.end, rates.end)
    canvas.line(places, color, width, clip=pane)
    for place in places if len(places) < 4 else places[-1:] if run.state == RUNNING else []:
        canvas.dot(*place, size * 0.36, color, pane)


@dataclass(frozen=True)
class _Legend:
    """Which colour is which run, in the corner where there is no error as a rule: right at the top."""

    lines: tuple[tuple[Run, str], ...]
    left: float
    height: float

    @staticmethod
    def of(runs: Sequence[Run], x: LogAxis, size: float) -> _Legend:
        """Of names that would take more than most of the pane the last parts are left out; numbers stay."""
        names = names_of(runs)
        letters = int((x.end - x.start) * 0.6 / text_width("x", size))
        lines = tuple(
            (run, _fitting(names[run.number], " (running)" if run.state == RUNNING else "", letters)) for run in runs
        )
        width = max((text_width(text, size) for _, text in lines), default=0) + 5 * size
        return _Legend(lines, x.end - size - width, (line_height(size) * len(lines) + 1.6 * size) if lines else 0.0)

    def draw(self, canvas: Canvas, x: LogAxis, top: float, style: Style) -> None:
        """Below `top`, the upper edge of the pane."""
        if not self.lines:
            return
        size = style.text_size
        canvas.rectangle(self.left, top - self.height, x.end - size, top - size, style.background, 0.85)
        for i, (run, text) in enumerate(self.lines):
            y = top - size - line_height(size) * (i + 1) + 0.6 * size
            color = SLOT_COLORS[run.slot % len(SLOT_COLORS)]
            canvas.line([(self.left + size, y + size / 2), (self.left + 3 * size, y + size / 2)], color, size * 0.4)
            canvas.text(self.left + 4 * size, y, text, size, style.text)


def _error_axis(runs: Sequence[Run], target: float, x: LogAxis, bottom: float, top: float, size: float) -> LogAxis:
    """Axis of the errors; with room for the legend above them, if it would hide one."""
    values = _errors(runs, target)
    axis = LogAxis.around(values, bottom, top, 10.0, 0.06)
    legend = _Legend.of(runs, x, size)
    hidden = any(
        x.at(p.seconds) >= legend.left - size and axis.at(p.relmse) >= top - legend.height - size
        for run in runs
        for p in run.points
    )
    room = legend.height + size
    if not hidden or room > (top - bottom) / 2:
        return axis
    share = room / (top - bottom - room)
    return replace(axis, high=axis.high * (axis.high / axis.low) ** share)


def _fitting(name: str, state: str, letters: int) -> str:
    """`name` and `state`, without the last parts of the name that do not fit in so many letters."""
    while len(name + state) > letters and ", " in name:
        name = name.rpartition(", ")[0]
    return name + state
