"""The common part of the plots of studies. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot

# Colours that people who confuse colours distinguish (Okabe and Ito 2008)
BLUE, ORANGE, GREEN, RED, SKY, PINK, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#777777"
# Of a legend: a key, a letter, and a line [inch]; and lines that a figure has room for as it is
LEGEND_INCH, LEGEND_ROWS = (0.5, 0.062, 0.19), 4
# Of lines whose colours are used up
LINES = ("-", "--", ":", "-.")
COLORS = (BLUE, RED, GREEN, ORANGE, PINK, SKY, GREY)


def panels(count: int, width: float = 0.0, columns: int = 4) -> tuple[pyplot.Figure, list[pyplot.Axes]]:
    """A figure of `count` panels, in rows of `columns` at most; `width` of one [inch], 0: by their number."""
    columns = min(count, columns)
    rows = -(-count // columns)
    columns = -(-count // rows)  # as many in each row
    width = width or (6.5 if count == 1 else 4.6 if columns < 4 else 3.4)
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(width * columns, 0.6 + 3.1 * rows), squeeze=False, constrained_layout=True
    )
    axes = axes.ravel()
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, list(axes[:count])


def legend(figure: pyplot.Figure, axes: list[pyplot.Axes], columns: int = 4) -> None:
    """One for all panels, below them, each name once; in as many of `columns` as the figure is wide enough for."""
    found: dict[str, Any] = {}
    for axis in axes:
        for handle, text in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(text, handle)
    width, height = figure.get_size_inches()
    columns = max(1, min(columns, len(found), int(width / (LEGEND_INCH[0] + LEGEND_INCH[1] * max(map(len, found))))))
    rows = -(-len(found) // columns)
    figure.set_size_inches(width, height + LEGEND_INCH[2] * max(0, rows - LEGEND_ROWS))
    figure.legend(list(found.values()), list(found), fontsize=8, loc="outside lower center", ncols=columns)


def save(figure: pyplot.Figure, folder: Path, name: str) -> None:
    """Write a plot; the same data give the same file."""
    matplotlib.rcParams["svg.hashsalt"] = name
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.svg", facecolor="white", metadata={"Date": None})
    pyplot.close(figure)
