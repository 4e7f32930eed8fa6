"""Rows of a study: one JSON object a line, written as soon as it is measured, so that a study cut short goes on where
it was.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lib.command import UsageError
from lib.output import write_text

from studies.study import Report, Row


def alike(header: dict[str, Any]) -> dict[str, Any]:
    """What of a header must be equal for rows to go together: figures of two devices or versions are no medians of
    one.
    """
    device, versions = header.get("device") or {}, header.get("versions") or {}
    own = {name: header.get(name) for name in ("study", "device_kind", "quick", "definition")}
    return own | {"device": device.get("name"), "raybatch": versions.get("raybatch"), "warp": versions.get("warp")}


class RowFile:
    """A file of rows under a header, which says what they are of."""

    def __init__(self, path: Path, header: dict[str, Any]):
        """Goes on with the file, if there is one, else begins it with the first row; raises `UsageError` where it holds
        something else.
        """
        self.path, self._header = path, header
        self.rows: list[Row] = []
        if path.exists():
            found, self.rows = read_rows(path)
            wanted = alike(header)
            for name, value in alike(found).items():
                if value != wanted[name] and name == "definition":
                    raise UsageError(
                        f"{path} holds rows that were measured with other common settings, or another reference: "
                        "choose another --out, or give --fresh to measure all of it again"
                    )
                if value != wanted[name]:
                    raise UsageError(
                        f"{path} holds rows with {name} = {value!r}, and this is {wanted[name]!r}: choose another "
                        "--out, or give --fresh to measure all of it again"
                    )

    def has(self, key: str, turn: int) -> bool:
        """Whether this was measured."""
        return any(row["case"] == key and row["turn"] == turn for row in self.rows)

    def add(self, row: Row) -> None:
        """Write it at once."""
        line = json.dumps(row, allow_nan=False)
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            line = json.dumps({"header": self._header}) + "\n" + line
        with self.path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        self.rows.append(row)


def read_rows(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Header and rows of a file; a last line that was cut short is dropped. Raises `UsageError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror or error}") from None
    lines = text.splitlines()
    if lines and not text.endswith("\n"):
        path_lines = lines[:-1]
        write_text(path, "".join(f"{line}\n" for line in path_lines))
        lines = path_lines
    try:
        header, *rows = [json.loads(line) for line in lines]
        return dict(header["header"]), rows
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path} holds no rows of a study: is it damaged? Give --fresh to measure again") from None


def gathered(files: Sequence[Path]) -> Report:
    """One report of files by parts of one study on one device: the header's entries, and `rows`; raises
    `UsageError`.
    """
    report: Report = {}
    seen: set[tuple[str, int]] = set()
    for path in files:
        header, rows = read_rows(path)
        if not report:
            report = {**header, "rows": []}
        first = alike(report)
        for name, value in alike(header).items():
            if value != first[name]:
                raise UsageError(
                    f"{path} and {files[0]} do not go together: their {name} is {value!r} and {first[name]!r}"
                )
        for row in rows:
            if (row["case"], row["turn"]) not in seen:
                seen.add((row["case"], row["turn"]))
                report["rows"].append(row)
    if not report:
        raise UsageError("no file of rows was given")
    return report


def write_report(path: Path, report: Report) -> None:
    """Write rows as JSON, a row a line."""
    head = {name: value for name, value in report.items() if name != "rows"}
    rows = ",\n".join(json.dumps(row, allow_nan=False) for row in report["rows"])
    text = json.dumps(head, indent=1)[:-2] + ',\n "rows": [\n' + rows + "\n]}\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)


def read_report(path: Path) -> Report:
    """What `write_report` wrote; raises `UsageError`."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if report["rows"] and None not in (alike(report) | {"definition": ""}).values():
            return report
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise UsageError(
        f"{path} holds no figures of a study: is it damaged? Measure again, or give its rows with --gather"
    ) from None


def medians(rows: Sequence[Row], figure: str = "seconds") -> dict[str, float]:
    """Median of a figure over turns by case; rows without it are left out."""
    return {case: statistics.median(values) for case, values in by_case(rows, figure).items()}


def by_case(rows: Sequence[Row], figure: str = "seconds") -> dict[str, list[float]]:
    """A figure of all turns by case; rows without it are left out."""
    found: dict[str, list[float]] = {}
    for row in rows:
        if row.get(figure) is not None:
            found.setdefault(row["case"], []).append(row[figure])
    return found


def spread(rows: Sequence[Row]) -> tuple[float, float]:
    """Half the distance between the quartiles of a case over its median: of all cases the median, and of one in ten
    more than the second.
    """
    spreads = [0.0]
    for each in by_case(rows).values():
        if len(each) > 1:  # of two the quartiles are taken to be both
            low, high = min(each), max(each)
            if len(each) > 2:
                low, _, high = statistics.quantiles(each, n=4)
            spreads.append((high - low) / 2 / statistics.median(each))
    spreads.sort()
    return statistics.median(spreads), spreads[len(spreads) * 9 // 10]


def ratios_in_turns(rows: Sequence[Row], case: str, base: str) -> list[float]:
    """Seconds of `base` over those of `case` in each turn that has both, the least first; empty where none has."""
    seconds = {(row["case"], row["turn"]): row["seconds"] for row in rows if row.get("seconds")}
    turns = {turn for _, turn in seconds}
    return sorted(
        seconds[base, turn] / seconds[case, turn]
        for turn in turns
        if (base, turn) in seconds and (case, turn) in seconds
    )


def first_rows(rows: Sequence[Row]) -> dict[str, Row]:
    """A row for each case: of its first turn."""
    found: dict[str, Row] = {}
    for row in rows:
        found.setdefault(row["case"], row)
    return found


def differing_films(rows: Sequence[Row], by: Sequence[str]) -> list[str]:
    """Keys of cases whose film differs from that of the first case with the same values of `by`; films cut short do not
    count.
    """
    first: dict[tuple, str] = {}
    wrong: list[str] = []
    for row in rows:
        if row.get("film") and row.get("complete"):
            place = tuple(row.get(name) for name in by)
            if first.setdefault(place, row["film"]) != row["film"] and row["case"] not in wrong:
                wrong.append(row["case"])
    return wrong
