"""What warps did, as tables of Markdown and as a plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from studies.pages import number, table
from studies.study import Report, Row
from studies.top_level.cases import KINDS, SCENES, SELECTIONS, WAYS
from studies.top_level.warps import LANES

HEADS = (
    "rays",
    "way",
    "nodes that warps read",
    "of NAIVE's",
    "rays for each",
    "nodes that rays visit",
    "turns of lanes",
    "waits",
)


def found(report: Report) -> dict[tuple[str, str, str, str], Row]:
    """Rows by scene, kind of rays, selection and way."""
    return {(row["scene"], row["kind"], row["selection"], row["way"]): row for row in report["rows"]}


def one_report(reports: dict[str, Report]) -> Report:
    """The CPU's, or else any: emulated warps know no device."""
    return reports.get("cpu") or next(iter(reports.values()))


def fragment(reports: dict[str, Report]) -> str:
    """A table for each scene and selection; figures of a ray."""
    rows, parts = found(one_report(reports)), []
    for scene in SCENES:
        for selection in SELECTIONS:
            there = [row for key, row in rows.items() if (key[0], key[2]) == (scene, selection)]
            if there:
                head = (
                    f"**{scene}**, {selection}: {there[0]['rays']:,} rays of each kind, {there[0]['treelets']} treelets"
                )
                parts += [head, table(HEADS, _lines(rows, scene, selection))]
    return "\n\n".join(parts)


def _lines(rows: dict[tuple[str, str, str, str], Row], scene: str, selection: str) -> list[list[Any]]:
    lines = []
    for kind in KINDS:
        base = rows.get((scene, kind, selection, WAYS[0]))
        for way in WAYS:
            row = rows.get((scene, kind, selection, way))
            if not row or not base:
                continue
            rays = row["rays"]
            figures = [row["fetches"] / rays, row["fetches"] / base["fetches"], row["visits"] / row["fetches"]]
            figures += [row["visits"] / rays, row["turns"] * LANES / rays, row["queued"] / rays]
            lines.append([kind, way, *(number(each) for each in figures)])
    return lines


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Nodes that warps read, and turns, over those of NAIVE, of sweeps."""
    from studies import plots

    rows = found(one_report(reports))
    present = [scene for scene in SCENES if (scene, KINDS[0], SELECTIONS[0], WAYS[0]) in rows]
    figure, axes = plots.panels(2)
    names = [f"{scene}, {kind}" for scene in present for kind in KINDS]
    for axis, of, title in zip(axes, ("fetches", "turns"), ("nodes that warps read", "turns of warps"), strict=True):
        for i, way in enumerate(WAYS):
            values = [
                rows[scene, kind, SELECTIONS[0], way][of] / rows[scene, kind, SELECTIONS[0], WAYS[0]][of]
                for scene in present
                for kind in KINDS
            ]
            places = [j + 0.2 * (i - 1.5) for j in range(len(names))]
            axis.barh(places, values, height=0.2, color=plots.COLORS[i], label=way)
        axis.axvline(1.0, color="#888888", linewidth=0.8)
        axis.set_xscale("log")
        axis.set_xlabel(f"{title}, over those of NAIVE")
        axis.set_yticks(range(len(names)), names if of == "fetches" else [""] * len(names), fontsize=7)
        axis.invert_yaxis()
    axes[0].legend(fontsize=7)
    plots.save(figure, folder, "top-level")
