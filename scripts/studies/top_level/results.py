"""What warps did, as tables of Markdown and as a plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from studies.pages import machine, number, table
from studies.rows import medians
from studies.schedulers.results import spread
from studies.study import Report, Row
from studies.top_level import rates
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


def fragment(reports: dict[str, Report]) -> str:
    """Of emulated warps a table for each scene and selection, with figures of a ray; of a GPU one of rates."""
    parts = [counts_of(reports["cpu"])] if "cpu" in reports else []
    return "\n\n".join([*parts, rates_of(reports["cuda"])] if "cuda" in reports else parts)


def rates_of(report: Report) -> str:
    """Rates of whole traces on a GPU over those with NAIVE, and the spread of turns."""
    seconds = medians(report["rows"])
    rays = {row["case"]: row["rays"] for row in report["rows"] if row.get("rays")}
    lines = []
    for scene in rates.SCENES:
        for selection in rates.SELECTIONS:
            for kind in KINDS:
                times = [seconds.get(f"{scene} {kind} {selection} {way}") for way in WAYS]
                if times[0]:
                    base = rays[f"{scene} {kind} {selection} {WAYS[0]}"] / times[0] / 1e6
                    others = [f"{times[0] / each:.2f}" if each else "not measured" for each in times[1:]]
                    lines.append([f"{scene}, {selection}", kind, number(base), *others])
    usual, much = spread(report)
    wrong = sorted({row["case"] for row in report["rows"] if row.get("wrong")})
    hits = f"**Hits differ**, which must not be: {', '.join(wrong)}." if wrong else "All found the same hits."
    said = f"{machine(report)} Half the distance of the quartiles is {usual:.1%} of the median, in a tenth of the cases"
    heads = ["scene, selection", "rays", f"{WAYS[0]}, Mrays/s", *WAYS[1:]]
    return f"{said} more than {much:.1%}. {hits}\n\n{table(heads, lines)}"


def counts_of(report: Report) -> str:
    """Tables of what emulated warps did."""
    rows, parts = found(report), []
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

    if "cpu" not in reports:
        return
    rows = found(reports["cpu"])
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
