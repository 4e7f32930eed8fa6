"""Plots of a study of one's own: each measure over each axis that is numeric, and errors over time."""

from __future__ import annotations

import itertools
import statistics
from pathlib import Path
from typing import Any

from studies.own.definition import Definition, label_of
from studies.own.measures import MEASURES, Measure
from studies.pages import device_title
from studies.study import Report

STYLES = ("o-", "s--", "^:", "D-.")
LOG_FROM = 8  # an axis whose largest value is so many times the smallest is logarithmic
ERROR = "error"  # name of the plot of errors


def numeric_axes(definition: Definition) -> list[str]:
    """Axes with several values that are numbers."""
    return [
        name
        for name, values in definition.axes.items()
        if len(values) > 1 and all(isinstance(value, (int, float)) for value in values)
    ]


def plot_names(definition: Definition) -> dict[str, str]:
    """Names of the plots, which their files end with, and what they show."""
    found = {name.replace("_", "-"): f"Measures by {name}" for name in numeric_axes(definition)}
    return found | ({ERROR: "Error over time"} if definition.measures_errors else {})


def draw_axes(definition: Definition, reports: dict[str, Report], folder: Path) -> None:
    """Draw them into `folder`."""
    from studies.own.page import asked_for

    reports = {kind: asked_for(definition, report) for kind, report in reports.items()}
    for axis in numeric_axes(definition):
        _draw_axis(definition, reports, folder, axis)
    if definition.measures_errors and any(row.get("points") for each in reports.values() for row in each["rows"]):
        from studies.curves import draw_curves

        draw_curves(reports, folder, f"{definition.name}-{ERROR}")


def _draw_axis(definition: Definition, reports: dict[str, Report], folder: Path, axis: str) -> None:
    from studies.plots import COLORS, legend, panels, save

    places = [(scene.name, MEASURES[name]) for scene in definition.scenes for name in definition.measures]
    figure, axes = panels(len(places), columns=max(1, min(4, len(definition.measures))))
    others = {name: values for name, values in definition.axes.items() if name != axis}
    combinations = [dict(zip(others, values, strict=True)) for values in itertools.product(*others.values())]
    many = len(reports) > 1
    for panel, (scene, measure) in zip(axes, places, strict=True):
        most = 0.0
        for style, report in zip(STYLES, reports.values()):
            for number, fixed in enumerate(combinations):
                points = points_of(definition, report, scene, measure, axis, fixed)
                if not points:
                    continue
                label = ", ".join(([device_title(report)] if many else []) + ([label_of(fixed)] if fixed else []))
                x, middle, low, high = zip(*points, strict=True)
                color = COLORS[number % len(COLORS)]
                line = style if number < len(COLORS) else STYLES[1 + number // len(COLORS) % 3]
                panel.plot(x, middle, line, color=color, markersize=4, label=label or None)
                panel.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0)
                most = max(most, *high)
        panel.set(xlabel=axis, ylabel=measure.title, title=scene)
        values = [value for value in definition.axes[axis] if value > 0]
        if len(values) == len(definition.axes[axis]) and max(values) >= LOG_FROM * min(values):
            panel.set_xscale("log", base=2)
            panel.set_xticks(values, [f"{value:g}" for value in values])
            panel.minorticks_off()
        if most > 0:
            panel.set_ylim(0, 1.08 * most)
    if any(axes[0].get_legend_handles_labels()[1]):
        legend(figure, axes)
    save(figure, folder, f"{definition.name}-{axis.replace('_', '-')}")


def points_of(
    definition: Definition, report: Report, scene: str, measure: Measure, axis: str, fixed: dict[str, Any]
) -> list[tuple[float, float, float, float]]:
    """Value of the axis, median, least and largest of the figure, of the cases with the other axes' values `fixed`."""
    found = []
    for case in definition.cases:
        if not case.axes or any(case.axes[name] != value for name, value in fixed.items()):
            continue
        rows = [row for row in report["rows"] if row["scene"] == scene and row["variant"] == case.label]
        values = [value for row in rows if (value := measure.value(row)) is not None]
        if values:
            found.append((case.axes[axis], statistics.median(values), min(values), max(values)))
    return sorted(found)
