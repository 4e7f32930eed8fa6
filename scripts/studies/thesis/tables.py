"""The page of the study: a summary, the effect of each parameter, and all tables beside the thesis's."""

from __future__ import annotations

import itertools
import math
import statistics
from typing import Any

from studies.bench import whole_seconds
from studies.pages import device_title, films_line, machine, number, table
from studies.rows import differing_films, first_rows
from studies.study import Report
from studies.thesis.cases import ORDERS, RAY_COUNTS, SCENES, STORAGES, TREELET_SIZES
from studies.thesis.results import COLUMNS, control_seconds, figures, key_of, most_alive, seconds_by_key


def fragment(reports: dict[str, Report]) -> str:
    """Summary, effects, and all three tables."""
    theirs = figures()
    parts = [f"- {machine(report)}" for report in reports.values()]
    wrong = [each for report in reports.values() for each in differing_films(report["rows"], ("scene", "edge"))]
    whole = sum(bool(row["complete"]) for report in reports.values() for row in report["rows"])
    parts += [f"- {films_line(wrong, whole)}", *_control_lines(reports), *_alive_lines(reports), ""]
    parts += ["### In short", "", _summary_table(reports, theirs), "", _shape_table(reports), ""]
    parts += [
        "### What each parameter does",
        "",
        _effects_table(reports, theirs),
        "",
        "![All combinations](thesis-initial.svg)",
        "",
    ]
    for name, title in (
        ("ray_count", "Rays alive (appendix D)"),
        ("queue_size", "Size of a queue's block (appendix E)"),
    ):
        parts += [
            f"### {title}",
            "",
            f"![{title}](thesis-{name.replace('_', '-')}.svg)",
            "",
            _full_table(name, reports, theirs),
            "",
        ]
    parts += ["### All 96 combinations (appendix C)", "", _full_table("initial", reports, theirs)]
    return "\n".join(parts)


def _alive_lines(reports: dict[str, Report]) -> list[str]:
    """Where cases asked for more rays than there were."""
    found = {device_title(report): most_alive(report) for report in reports.values()}
    return [
        f"- {device}: at most {most:,} rays were alive, all that the tiles at work have; cases that asked for more "
        "repeat that one."
        for device, most in found.items()
        if most
    ]


def _control_lines(reports: dict[str, Report]) -> list[str]:
    """How much the machine's own speed changed meanwhile."""
    lines = []
    for report in reports.values():
        reported = []
        for scene in SCENES:
            found = [
                row["seconds"]
                for row in report["rows"]
                if row["table"] == "control" and row["scene"] == scene and row["complete"]
            ]
            if len(found) > 1:
                reported.append(f"{number(min(found))} to {number(max(found))} s ({scene})")
        if reported:
            lines.append(
                f"- {device_title(report)}: the control, which was rendered in each group of cases, took "
                f"{' and '.join(reported)}: so much the machine's speed changed."
            )
    return lines


def _full_table(name: str, reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    ours = {kind: seconds_by_key(report, name) for kind, report in reports.items()}
    rows, listed = [], theirs[name]["rows"]
    for row in sorted(listed, key=lambda each: (each["scene"], each["seconds"])) if name == "initial" else listed:
        key = key_of(row, COLUMNS[name])
        rows.append(
            [
                *key,
                f"{row['seconds']:.2f}",
                *(number(*_with_digits(found.get(key, (None, True)))) for found in ours.values()),
            ]
        )
    return table(
        [
            *(column.replace("_", " ") for column in COLUMNS[name]),
            "thesis [s]",
            *(f"{device_title(r)} [s]" for r in reports.values()),
        ],
        rows,
    )


def _with_digits(found: tuple[float | None, bool]) -> tuple[float | None, int, bool]:
    return found[0], 3, found[1]


def _summary_table(reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    rows = []
    for scene in SCENES:
        best = min((row for row in theirs["initial"]["rows"] if row["scene"] == scene), key=lambda row: row["seconds"])
        worst = max(row["seconds"] for row in theirs["initial"]["rows"] if row["scene"] == scene) / best["seconds"]
        rows.append(
            [
                scene,
                "thesis, RTX 2080, one warp",
                _words(key_of(best, COLUMNS["initial"])[1:]),
                f"{best['seconds']:.1f}",
                f"{worst:.1f}",
                "",
            ]
        )
        for report in reports.values():
            ours = {p: s for p, (s, _) in seconds_by_key(report, "initial").items() if p[0] == scene and s is not None}
            if not ours:
                continue
            key = min(ours, key=lambda each: ours[each])
            control = control_seconds(report, scene)
            edge = next(row["edge"] for row in report["rows"] if "edge" in row)
            slower = number(max(ours.values()) / ours[key])
            rows.append(
                [
                    scene,
                    f"{device_title(report)}, {edge} x {edge}",
                    _words(key[1:]),
                    number(ours[key]),
                    slower,
                    number(control),
                ]
            )
            for row in report["rows"]:
                if row["table"] == "one_warp" and row["scene"] == scene and row["turn"] == 0:
                    seconds = number(whole_seconds(row), 3, not row["complete"])
                    rows.append(
                        [
                            scene,
                            f"{device_title(report)}, one warp",
                            _words(key_of(row, COLUMNS["initial"])[1:]),
                            seconds,
                            "",
                            "",
                        ]
                    )
    return table(["scene", "tracer", "best combination", "seconds", "worst over best", "without queues [s]"], rows)


def _words(key: tuple) -> str:
    return ", ".join(map(str, key))


def _shape_table(reports: dict[str, Report]) -> str:
    rows, own = [], figures()["initial"]["rows"]
    for report in reports.values():
        seen = set()
        for row in first_rows(report["rows"]).values():
            key = (row["scene"], row.get("treelet_size"))
            if row["table"] == "initial" and row.get("treelets") and key not in seen:
                seen.add(key)
                theirs = next(r["treelets"] for r in own if (r["scene"], r["treelet_size"]) == key)
                rows.append([device_title(report), *key, row["treelets"], f"{row['treelet_nodes']:.0f}", theirs])
    return table(["tree of", "scene", "treelet size", "treelets", "nodes of one, mean", "treelets of the thesis"], rows)


def _effects_table(reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    """Time relative to the first value of a parameter, geometric means over all other parameters."""
    sources = [("thesis", {key_of(row, COLUMNS["initial"]): row["seconds"] for row in theirs["initial"]["rows"]})]
    sources += [
        (device_title(r), {p: s for p, (s, _) in seconds_by_key(r, "initial").items() if s is not None})
        for r in reports.values()
    ]
    rows = []
    for index, (name, values) in enumerate(
        zip(COLUMNS["initial"][1:], (ORDERS, STORAGES, TREELET_SIZES, RAY_COUNTS), strict=True), start=1
    ):
        for value in values[1:]:
            cells = []
            for (_, found), scene in itertools.product(sources, SCENES):
                ratios = []
                for key, seconds in found.items():
                    first = key[:index] + (values[0],) + key[index + 1 :]
                    if key[0] == scene and key[index] == value and first in found:
                        ratios.append(math.log(seconds / found[first]))
                cells.append(f"{math.exp(statistics.mean(ratios)):.2f}" if ratios else "")
            rows.append([f"`{name}`", f"{value} over {values[0]}", *cells])
    return table(
        ["parameter", "time of", *(f"{source}, {scene}" for (source, _), scene in itertools.product(sources, SCENES))],
        rows,
    )
