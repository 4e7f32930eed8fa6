"""The page of a study of one's own: machines, the comparison of films, plots, a table, and its definition."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from benchmarking.timing import spread

from studies.curves import curves_table
from studies.own.definition import Definition, OwnCase
from studies.own.measures import MEASURES, Measure
from studies.own.plots import plot_names
from studies.pages import device_title, machine, number, table
from studies.rows import differing_films
from studies.study import Report, Row


def page_fragment(definition: Definition, plots: bool, reports: dict[str, Report]) -> str:
    """All of the page, below its title; with its plots, if they were drawn."""
    reports = {kind: asked_for(definition, report) for kind, report in reports.items()}
    parts = [definition.about, ""] if definition.about else []
    parts += [f"- {machine(report)}" for report in reports.values()]
    parts += [*(f"- {line}" for line in frames(reports)), f"- {compared(reports)}", ""]
    for name, about in plot_names(definition).items() if plots else ():
        parts += [f"![{about}]({definition.name}-{name}.svg)", ""]
    parts += [cases_table(definition, reports), "", legend(definition)]
    if warned := warnings(reports):
        parts += ["", "Renders warned:", "", *warned]
    if definition.measures_errors and any(row.get("points") for each in reports.values() for row in each["rows"]):
        parts += ["", "Time to the error that the first case came to (~: extrapolated):", ""]
        parts += [curves_table({k: each for k, each in reports.items() if each["rows"]}, "case")]
    kind = "json" if definition.source.lstrip().startswith("{") else "toml"
    return "\n".join([*parts, "", "The study:", "", f"```{kind}", definition.source.strip(), "```"])


def asked_for(definition: Definition, report: Report) -> Report:
    """`report` with those rows that the study still asks for."""
    keys = {f"{scene.key}: {case.key}" for scene in definition.scenes for case in definition.cases}
    return {**report, "rows": [row for row in report["rows"] if row["case"] in keys]}


def frames(reports: dict[str, Report]) -> list[str]:
    """Scenes and the sizes of their pictures."""
    found: dict[str, str] = {}
    for report in reports.values():
        for row in report["rows"]:
            if "width" in row:
                found.setdefault(row["scene"], f"{row['scene']}: {row['width']} x {row['height']} pixels.")
    return list(found.values())


def compared(reports: dict[str, Report]) -> str:
    """Whether films are equal bit for bit where they must be: where the schedule alone differs."""
    groups: dict[tuple[str, str, str], set[str]] = {}
    wrong: list[str] = []
    count = 0
    for kind, report in reports.items():
        wrong += differing_films(report["rows"], ("scene", "estimator"))
        for row in report["rows"]:
            if row.get("film") and row.get("complete"):
                groups.setdefault((kind, row["scene"], row["estimator"]), set()).add(row["case"])
                count += 1
    if wrong:
        return f"**Films differ where the schedule alone does**, which must not be: {'; '.join(wrong[:8])}."
    alike = [cases for cases in groups.values() if len(cases) > 1]
    if not alike:
        return "No two cases differ in their schedule alone: films of different cases are not compared."
    return (
        f"All {count:,} films are equal bit for bit where the schedule alone differs: {len(alike):,} "
        f"{'group' if len(alike) == 1 else 'groups'} of {max(map(len, alike)):,} cases at most."
    )


def cases_table(definition: Definition, reports: dict[str, Report]) -> str:
    """A line a case: medians, half their spread, and ratios to the control."""
    many_scenes, many_devices = len(definition.scenes) > 1, len(reports) > 1
    by_axes = all(case.axes for case in definition.cases)
    measures = [MEASURES[name] for name in definition.measures]
    lines, compares = [], set()  # measures of which there is a ratio
    for report in reports.values():
        for scene in definition.scenes:
            rows = [row for row in report["rows"] if row["scene"] == scene.name]
            for case in definition.cases:
                mine = [row for row in rows if row["variant"] == case.label]
                if not mine:
                    continue
                line: list[Any] = [device_title(report)] if many_devices else []
                line += [scene.name] if many_scenes else []
                line += list(case.axes.values()) if by_axes else [case.label]
                for measure in measures:
                    line.append(median_cell(measure, mine))
                    over = ratio(measure, case, mine, rows)
                    line.append(number(over))
                    if over is not None:
                        compares.add(measure.title)
                lines.append([*line, note(definition, case, mine[0])])
    heads = (["device"] if many_devices else []) + (["scene"] if many_scenes else [])
    heads += list(definition.axes) if by_axes else ["case"]
    for measure in measures:
        heads += [measure.title, "over control" if measure.title in compares else ""]
    heads.append("remarks")
    left_out = {place for place, head in enumerate(heads) if not head}
    if not any(line[-1] for line in lines):
        left_out.add(len(heads) - 1)
    kept = [[cell for place, cell in enumerate(line) if place not in left_out] for line in (heads, *lines)]
    return table(kept[0], kept[1:])


def values_of(measure: Measure, rows: Sequence[Row]) -> dict[int, float]:
    """A figure by turn, of the turns that have it."""
    found = {row["turn"]: measure.value(row) for row in rows}
    return {turn: value for turn, value in found.items() if value is not None}


def median_cell(measure: Measure, rows: Sequence[Row]) -> str:
    """The median over turns, and half the spread of several."""
    values = list(values_of(measure, rows).values())
    if not values:
        return ""
    middle = number(statistics.median(values))
    if len(values) < 2 or not statistics.median(values) or max(values) == min(values):
        return middle
    return f"{middle} ± {50 * spread(values):.0f} %"


def ratio(measure: Measure, case: OwnCase, mine: Sequence[Row], rows: Sequence[Row]) -> float | None:
    """Median over turns of a case's figure over that of its control in the same turn; None where either is missing."""
    if case.control is None:
        return None
    theirs = values_of(measure, [row for row in rows if row["variant"] == case.control])
    ratios = [value / theirs[turn] for turn, value in values_of(measure, mine).items() if theirs.get(turn)]
    return statistics.median(ratios) if ratios else None


def note(definition: Definition, case: OwnCase, row: Row) -> str:
    """What else there is to say of a case."""
    if row.get("refused"):
        return f"refused: {row['refused']}".replace("|", "/")
    asked = {**definition.common, **case.settings}.get("batching", "AUTO")
    said = [] if row.get("complete") else [f"ended at {100 * row['share']:.0f} %"]
    if asked == "AUTO" and row.get("method"):
        said.append(f"batching chosen: {row['method']}")
    return "; ".join(said)


def warnings(reports: dict[str, Report]) -> list[str]:
    """What renders warned of, each once, with the cases that it is about."""
    found: dict[str, list[str]] = {}
    for report in reports.values():
        for row in report["rows"]:
            for text in row.get("warnings", ()):
                cases = found.setdefault(text, [])
                if row["variant"] not in cases:
                    cases.append(row["variant"])
    return [f"- {text} (in {'; '.join(cases)})." for text, cases in found.items()]


def legend(definition: Definition) -> str:
    """What the table's columns are."""
    lines = [f"- {MEASURES[name].title}: {MEASURES[name].about}." for name in definition.measures]
    text = "Medians over turns, ± half the spread (largest less smallest, over the median)"
    if any(case.control for case in definition.cases):
        controls = list(dict.fromkeys(case.control for case in definition.cases if case.control))
        named = f": {controls[0]}" if len(controls) == 1 else ", the case that is equal but for what the study names"
        text += f"; *over control* is the median over turns of the ratio to the control in the same turn{named}"
    return "\n".join([f"{text}.", "", *lines])
