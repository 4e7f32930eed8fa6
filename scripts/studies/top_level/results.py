"""What warps did, as tables of Markdown and as a plot."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from studies.pages import hits_line, machine, number, table
from studies.rows import medians, ratios_in_turns
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
    """Rates of whole traces on a GPU over those with NAIVE: medians of turns, and the least and the most of them."""
    rows = report["rows"]
    seconds, rays = medians(rows), {row["case"]: row["rays"] for row in rows if row.get("rays")}
    lines = []
    for scene in rates.SCENES:
        for selection in rates.SELECTIONS:
            for kind in KINDS:
                naive, *others = (f"{scene} {kind} {selection} {way}" for way in WAYS)
                if naive in seconds:
                    over = [_extent(ratios_in_turns(rows, each, naive)) for each in others]
                    lines.append([f"{scene}, {selection}", kind, number(rays[naive] / seconds[naive] / 1e6), *over])
    said = f"{machine(report)} Rates over those of {WAYS[0]} in the same turn, in brackets the least and the most."
    return f"{said} {hits_line(rows)}\n\n{table(['scene, selection', 'rays', f'{WAYS[0]}, Mrays/s', *WAYS[1:]], lines)}"


def _extent(ratios: Sequence[float]) -> str:
    if not ratios:
        return "not measured"
    middle = f"{statistics.median(ratios):.2f}"
    return f"{middle} ({ratios[0]:.2f} to {ratios[-1]:.2f})" if len(ratios) > 1 else middle


def counts_of(report: Report) -> str:
    """Tables of what emulated warps did."""
    rows, parts = found(report), []
    parts.append("Figures of a ray, in the top level alone, on warps that are emulated.")
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
    from converging.ticks import plain_ticks

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
            places = [j + 0.15 * (i - 1.5) for j in range(len(names))]
            axis.plot(values, places, "o", markersize=5, color=plots.COLORS[i], label=way)
        axis.axvline(1.0, color="#888888", linewidth=0.8)
        axis.set_xscale("log")
        plain_ticks(axis.xaxis, 0.15)
        axis.set_xlabel(f"{title}, over those of NAIVE ({SELECTIONS[0]})")
        axis.set_yticks(range(len(names)), names if of == "fetches" else [""] * len(names), fontsize=7)
        axis.invert_yaxis()
    plots.legend(figure, axes)
    plots.save(figure, folder, "top-level")
