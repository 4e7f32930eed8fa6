"""Curves of error, log-log: as a file, or as pieces of SVG that take the colours of the page they stand in. Needs
matplotlib.
"""

from __future__ import annotations

import importlib.util
import io
import math
import re
import statistics
from dataclasses import dataclass
from pathlib import Path

from lib.command import UsageError
from lib.output import write_whole

from converging.study import Run
from converging.summary import Summary, VariantOutcome
from raybatch_addon.core.convergence.points import ErrorPoint

FORMATS = (".svg", ".png", ".pdf")
# Okabe and Ito's colours, which those who see no red or green can tell apart, in an order that is read on white and on
# black
COLORS = ("#0b84d0", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8f7ee7", "#999999")
MARKERS = "osD^vP*X"
INK = "#010203"  # stands for the colour of the page's text, until it is replaced
SIZE = (5.6, 4.2)  # of a panel [inches]


@dataclass(frozen=True)
class Panel:
    """The axes of a plot."""

    y: str
    x: str
    y_label: str
    x_label: str


ERROR = Panel("relmse", "seconds", "relMSE", "seconds of rendering")
SAMPLES = Panel("rmse", "samples", "RMSE", "samples of every pixel")
FLIP = Panel("flip", "seconds", "FLIP", "seconds of rendering")


def require_plots(path: Path | None) -> None:
    """Raise `UsageError` where no plot can be drawn, or not as the file `path`."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError(
            "--plot and --html draw with matplotlib, which is not installed (pip install matplotlib); --json does "
            "without"
        )
    if path is not None and path.suffix.lower() not in FORMATS:
        raise UsageError(f"--plot {path}: name it with one of the endings {', '.join(FORMATS)}")


def panels(summary: Summary) -> list[Panel]:
    """The panels that have anything to show."""
    found = [ERROR, SAMPLES]
    if any(positive(point, "flip") for run in summary.study.runs for point in run.points):
        found.append(FLIP)
    return found


def write_plot(path: Path, summary: Summary) -> None:
    """All panels side by side, on white; raises `OutputError`."""
    wanted = panels(summary)
    pyplot = _pyplot()
    with pyplot.rc_context({"svg.hashsalt": "raybatch"}):
        figure, axes = pyplot.subplots(
            1, len(wanted), figsize=(SIZE[0] * len(wanted), SIZE[1]), squeeze=False, layout="constrained"
        )
        for place, panel in zip(axes[0], wanted, strict=True):
            draw(place, panel, summary, "black")
        study = summary.study
        figure.suptitle(f"{study.opened.name} on {study.device['name']}", fontsize=10, parse_math=False)
        metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
        write_whole(path, lambda temporary: figure.savefig(temporary, facecolor="white", dpi=110, metadata=metadata))
        pyplot.close(figure)


def svg_plots(summary: Summary) -> list[str]:
    """Each panel as SVG to stand within a page: lines of text and axes have `currentColor`, what is behind them shows
    through.
    """
    pyplot = _pyplot()
    found = []
    for number, panel in enumerate(panels(summary)):
        with pyplot.rc_context(
            {"svg.fonttype": "none", "svg.hashsalt": f"raybatch{number}", "font.family": "sans-serif"}
        ):
            figure, axes = pyplot.subplots(figsize=SIZE, layout="constrained")
            draw(axes, panel, summary, INK)
            made = io.StringIO()
            figure.savefig(
                made,
                format="svg",
                transparent=True,
                metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
            )
            pyplot.close(figure)
        found.append(_inlined(made.getvalue(), f"{panel.y_label} against {panel.x_label}"))
    return found


def _inlined(text: str, title: str) -> str:
    """Without what only a file needs, and with nothing that looks like an address."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href").replace(INK, "currentColor")
    return text.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)


def _pyplot():
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    return pyplot


# --- a panel


def draw(axes, panel: Panel, summary: Summary, ink: str) -> None:
    """Curves of all variants on `axes`; text and lines that are no curves have the colour `ink`."""
    from converging.ticks import plain_ticks

    axes.set_xscale("log")
    axes.set_yscale("log")
    for place, outcome in enumerate(summary.outcomes):
        _draw_curve(axes, panel, outcome, COLORS[place % len(COLORS)], MARKERS[place % len(MARKERS)])
    if panel is ERROR and summary.target:
        axes.axhline(summary.target, color=ink, linewidth=0.9, linestyle=(0, (6, 3)))
        axes.annotate(
            "target",
            (0.36, summary.target),
            xycoords=("axes fraction", "data"),
            ha="left",
            va="bottom",
            fontsize=8,
            color=ink,
        )
    floors = {used.floor[panel.y == "relmse"] for used in summary.study.used if panel.y != "flip"} - {None, 0.0}
    drawn = axes.get_ylim()
    for floor in floors:
        if floor > drawn[0] / 3:  # far below the curves it says nothing, and would press them together
            axes.axhline(floor, color=ink, linewidth=0.9, linestyle=":")
            axes.annotate(
                "noise of the reference",
                (0.005, floor),
                xycoords=("axes fraction", "data"),
                ha="left",
                va="bottom",
                fontsize=8,
                color=ink,
            )
    if panel is SAMPLES:
        _draw_guide(axes, summary, ink)
    axes.set_xlabel(panel.x_label, color=ink)
    axes.set_ylabel(panel.y_label, color=ink)
    axes.tick_params(which="both", colors=ink, labelsize=8)
    for spine in axes.spines.values():
        spine.set_color(ink)
    axes.grid(True, which="major", color=ink, alpha=0.18, linewidth=0.6)
    if axes.has_data():
        plain_ticks(axes.xaxis, 0.1)
        plain_ticks(axes.yaxis, 0.07)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, labelcolor=ink)


def _draw_curve(axes, panel: Panel, outcome: VariantOutcome, color: str, marker: str) -> None:
    """The median of all runs, a band from the least to the most, and each run in thin lines."""
    for run in outcome.runs:
        shown = [point for point in run.points if positive(point, panel.y) and positive(point, panel.x)]
        axes.plot(
            [getattr(p, panel.x) for p in shown],
            [getattr(p, panel.y) for p in shown],
            color=color,
            alpha=0.35,
            linewidth=0.7,
        )
    at, low, middle, high = medians(outcome.runs, panel)
    if at:
        axes.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
        axes.plot(at, middle, color=color, marker=marker, markersize=3.5, linewidth=1.5, label=outcome.variant.label)


def medians(runs: list[Run], panel: Panel) -> tuple[list[float], list[float], list[float], list[float]]:
    """Median of x, and least, median and most of y, at the sample counts that all runs have.

    With adaptive sampling these are of the pixels that have most, for the mean differs from seed to seed.
    """
    by_samples: dict[float, list[ErrorPoint]] = {}
    for run in runs:
        for point in run.points:
            if positive(point, panel.y) and positive(point, panel.x):
                by_samples.setdefault(point.samples_most or point.samples, []).append(point)
    rows = []
    for _, points in sorted(by_samples.items()):
        if len(points) == len(runs):
            values = [getattr(point, panel.y) for point in points]
            rows.append(
                (
                    statistics.median(getattr(point, panel.x) for point in points),
                    min(values),
                    statistics.median(values),
                    max(values),
                )
            )
    if not rows:
        return [], [], [], []
    at, low, middle, high = map(list, zip(*rows))
    return at, low, middle, high


def _draw_guide(axes, summary: Summary, ink: str) -> None:
    """Slope -0.5 from the first variant's first point on."""
    at, _, middle, _ = medians(summary.outcomes[0].runs, SAMPLES)
    if len(at) > 1:
        axes.plot(
            [at[0], at[-1]],
            [middle[0], middle[0] * (at[0] / at[-1]) ** 0.5],
            color=ink,
            alpha=0.55,
            linewidth=0.9,
            linestyle="-.",
            label="independent samples: slope -0.5",
        )


def positive(point: ErrorPoint, name: str) -> bool:
    """Whether it has a place on a logarithmic axis."""
    value = getattr(point, name)
    return value is not None and math.isfinite(value) and value > 0
