"""What was measured, as tables of Markdown and as a plot: rates over those of unbatched rays and of the default."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from pathlib import Path

from studies.pages import hits_line, machine, table
from studies.rays.captured import KINDS, SCENES
from studies.rows import spread
from studies.schedulers.cases import DEFAULT, PAGED, SCHEDULERS, SIZES, UNBATCHED, Schedule
from studies.study import Report

Key = tuple[str, str, str, str]  # scene, place, kind, schedule
TABLES: tuple[tuple[str, str, Sequence[Schedule]], ...] = (
    ("In memory, schedules", "memory", SCHEDULERS),
    ("In memory, sizes of treelets", "memory", (SCHEDULERS[0], *SIZES)),
    ("Beyond memory, a quarter of the tree at a time", "beyond", PAGED),
)


def medians(report: Report) -> dict[Key, float]:
    """Median seconds of each case."""
    seconds: dict[Key, list[float]] = {}
    for row in report["rows"]:
        if row.get("seconds") is not None:
            key = row["scene"], row["place"], row["kind"], row["schedule"]
            seconds.setdefault(key, []).append(row["seconds"])
    return {key: statistics.median(each) for key, each in seconds.items()}


def ratio(found: dict[Key, float], key: Key, base: str) -> float | None:
    """The rate of a case over that of the schedule `base`; None where one was not measured."""
    mine, theirs = found.get(key), found.get((*key[:3], base))
    return theirs / mine if mine and theirs else None


def fragment(reports: dict[str, Report]) -> str:
    """Tables of each device."""
    parts = []
    for report in reports.values():
        found = medians(report)
        usual, much = spread(report["rows"])
        parts += [
            machine(report)
            + f" Half the distance of the quartiles is {usual:.1%} of the median, in a tenth of the cases more than "
            f"{much:.1%}. {hits_line(report['rows'])}"
        ]
        for title, place, schedules in TABLES:
            for base in (UNBATCHED, DEFAULT):
                rows = _lines(found, place, schedules, base)
                if rows:
                    present = [scene for scene in SCENES if any(key[:2] == (scene, place) for key in found)]
                    heads = [f"{scene}, {kind}" for scene in present for kind in KINDS]
                    parts += [f"**{title}**: rate over that of {base}", table(["schedule", *heads, "mean"], rows)]
    return "\n\n".join(parts)


def _lines(found: dict[Key, float], place: str, schedules: Sequence[Schedule], base: str) -> list[list[str]]:
    present = [scene for scene in SCENES if any(key[:2] == (scene, place) for key in found)]
    lines = []
    for schedule in schedules:
        if schedule.name == base:
            continue
        ratios = [ratio(found, (scene, place, kind, schedule.name), base) for scene in present for kind in KINDS]
        there = [each for each in ratios if each]
        if there:
            mean = math.exp(statistics.mean(map(math.log, there)))
            lines.append([schedule.name, *(f"{each:.2f}" if each else "" for each in ratios), f"{mean:.2f}"])
    return lines


def draw(reports: dict[str, Report], folder: Path) -> None:
    """The mean rate of each schedule in memory over that of the default, by kind of rays."""
    from studies import plots

    figure, axes = plots.panels(len(reports))
    names = [each.name for each in (*SCHEDULERS[1:], *SIZES)]
    for axis, report in zip(axes, reports.values(), strict=True):
        found = medians(report)
        for i, kind in enumerate(KINDS):
            for j, name in enumerate(names):
                ratios = [ratio(found, (scene, "memory", kind, name), DEFAULT) for scene in SCENES]
                there = [each for each in ratios if each]
                axis.scatter(there, [j + 0.2 * (i - 1)] * len(there), s=9, color=plots.COLORS[i], label=kind)
        axis.axvline(1.0, color="#888888", linewidth=0.8)
        axis.set_xscale("log")
        axis.set_xlabel("rate over the default's, a point a scene")
        axis.set_yticks(range(len(names)), names, fontsize=6)
        axis.invert_yaxis()
        axis.set_title({"cuda": "GPU", "cpu": "CPU"}[report["device_kind"]], fontsize=9)
    plots.legend(figure, axes)
    plots.save(figure, folder, "schedulers")
