"""What was measured, as tables of Markdown and as a plot: seconds over those of the wavefront."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from studies.pages import device_title, films_line, machine, table
from studies.rows import by_case, differing_films, ratios_in_turns
from studies.streaming.cases import BATCHINGS, SCENES, SCHEDULES
from studies.study import Report, Row

WAVEFRONT, STREAMING = SCHEDULES
HEADS = ("scene", *(f"batching {each}" for each in BATCHINGS), "ON, over the wavefront's OFF", "million rays")


def over_wavefront(rows: Sequence[Row], scene: str, batching: str, base: str) -> float | None:
    """Seconds of the streaming schedule with `batching` over those of the wavefront with `base`: the median of turns;
    None where one was not measured.
    """
    found = ratios_in_turns(rows, f"{scene} {base} {WAVEFRONT}", f"{scene} {batching} {STREAMING}")
    return statistics.median(found) if found else None


def range_over_median(rows: Sequence[Row]) -> float:
    """The greatest distance between two turns of a case over its median, of all cases."""
    seconds = by_case(rows).values()
    return max(((max(each) - min(each)) / statistics.median(each) for each in seconds), default=0.0)


def fragment(reports: dict[str, Report]) -> str:
    """A table for each device."""
    parts = []
    for report in reports.values():
        rows = report["rows"]
        rays = {row["scene"]: row["rays"] for row in rows if row.get("rays")}
        lines = []
        for scene in SCENES:
            ratios = [over_wavefront(rows, scene, each, each) for each in BATCHINGS]
            ratios.append(over_wavefront(rows, scene, BATCHINGS[1], BATCHINGS[0]))
            if any(ratios):
                texts = ["" if each is None else f"{each:.2f}" for each in ratios]
                lines.append([scene, *texts, f"{rays[scene] / 1e6:.3g}"])
        films = sum(1 for row in rows if row.get("film") and row.get("complete"))
        short = " Renders of the quick study are too short to say which schedule is ahead." if report["quick"] else ""
        parts += [
            f"{machine(report)}{short} Seconds of the streaming schedule over those of the wavefront: below 1 the "
            f"streaming schedule is ahead. Turns of a case are at most {range_over_median(rows):.0%} apart. "
            + films_line(differing_films(rows, ("scene",)), films),
            table(HEADS, lines),
        ]
    return "\n\n".join(parts)


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Seconds over those of the wavefront with the same batching, by scene."""
    from studies import plots

    figure, axes = plots.panels(len(reports))
    for axis, report in zip(axes, reports.values(), strict=True):
        for i, batching in enumerate(BATCHINGS):
            found = [over_wavefront(report["rows"], scene, batching, batching) for scene in SCENES]
            there = [j for j, each in enumerate(found) if each]
            places, widths = [j + 0.35 * (i - 0.5) for j in there], [found[j] or 0.0 for j in there]
            axis.barh(places, widths, height=0.35, color=plots.COLORS[i], label=f"batching {batching}")
        axis.axvline(1.0, color="#888888", linewidth=0.8)
        axis.set_xlabel("seconds over the wavefront's")
        axis.set_yticks(range(len(SCENES)), [scene.replace("_", " ") for scene in SCENES], fontsize=8)
        axis.invert_yaxis()
        axis.set_title(device_title(report), fontsize=9)
    axes[0].legend(fontsize=7)
    plots.save(figure, folder, "streaming")
