"""The report of a part that was run on a GPU, complete or not."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lib.output import write_text

from testing.outcomes import FAILED, PASSED, SKIPPED, CheckOutcome
from testing.report import commit, today
from testing.run_units import BROKEN, DONE, RUNNING, STOPPED, WAITING, UnitRun

SLOWEST = 20  # tests and cases that are named


@dataclass(frozen=True)
class Earlier:
    """What an earlier report of the same part has: it is not run again."""

    units: tuple[dict[str, Any], ...] = ()  # rows of those that ended and did not fail
    commits: tuple[str, ...] = ()
    seconds: float = 0.0

    @staticmethod
    def of(path: Path, part: tuple[int, int]) -> Earlier:
        """The report in `path`; ValueError unless it is one of `part`."""
        try:
            report = json.loads(path.read_text(encoding="utf-8"))
            units = tuple(unit for unit in report["units"] if unit["state"] == DONE and not _has_failed(unit))
            earlier = Earlier(units, (*report.get("earlier_commits", ()), report["commit"]), report["seconds"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path} is no report of gpu.py: {error}") from None
        if report.get("part") != _text(part):
            raise ValueError(f"{path} is a report of part {report.get('part')}, not of {_text(part)}")
        return earlier

    @property
    def names(self) -> frozenset[str]:
        """Of the units."""
        return frozenset(unit["unit"] for unit in self.units)


NOTHING_EARLIER = Earlier()


def _has_failed(unit: dict[str, Any]) -> bool:
    return any(each["outcome"] == FAILED for each in unit["tests"])


def _text(part: tuple[int, int]) -> str:
    return "/".join(map(str, part))


def report_of(
    runs: Sequence[UnitRun], part: tuple[int, int], device: str, seconds: float, earlier: Earlier = NOTHING_EARLIER
) -> dict[str, Any]:
    """All that is known now; `seconds` since the part began to be run this time."""
    units = [*earlier.units, *map(_unit_row, runs)]
    counts = Counter(each["outcome"] for unit in units for each in unit["tests"])
    states = Counter(unit["state"] for unit in units)
    own = commit()
    return {
        "date": today(),
        "commit": own,
        "earlier_commits": sorted({each for each in earlier.commits if each != own}),
        "part": _text(part),
        "device": device,
        "cores": os.cpu_count(),
        "seconds": round(earlier.seconds + seconds, 1),
        "complete": states[DONE] == len(units),
        "passed": counts[PASSED],
        "failed": counts[FAILED] + states[BROKEN],
        "skipped": counts[SKIPPED],
        "units_not_ended": states[WAITING] + states[RUNNING] + states[STOPPED],
        "units": units,
    }


def _unit_row(run: UnitRun) -> dict[str, Any]:
    row = {
        "unit": run.unit.name,
        "state": run.state,
        "seconds": round(run.seconds, 1),
        "expected_seconds": round(run.unit.seconds, 1),
        "tests": [_row(each) for each in run.outcomes],
    }
    return row | ({"printed": run.printed()} if run.state == BROKEN else {})


def _row(outcome: CheckOutcome) -> dict[str, Any]:
    row = {"name": outcome.name, "outcome": outcome.outcome, "seconds": outcome.seconds}
    return row | ({"note": outcome.note} if outcome.note else {})


def write_report(path: Path, report: dict[str, Any]) -> None:
    """Write it whole: a reader sees the report before or this one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(report, indent=1) + "\n")


def summary(report: dict[str, Any]) -> str:
    """In words: what failed, what was not reached, what was slow, why tests were skipped, and the counts."""
    lines = []
    tests = [each for unit in report["units"] for each in unit["tests"]]
    for each in tests:
        if each["outcome"] == FAILED:
            lines += [f"FAILED {each['name']}", *(f"    {line}" for line in each.get("note", "").splitlines()[-8:])]
    for unit in report["units"]:
        if unit["state"] == BROKEN:
            lines += [f"BROKEN {unit['unit']}", *(f"    {line}" for line in unit["printed"].splitlines()[-8:])]
        elif unit["state"] != DONE:
            lines.append(f"not ended: {unit['unit']} ({len(unit['tests'])} ended, {unit['seconds']:.0f} s)")
    lines.append("slowest:")
    slowest = sorted(tests, key=lambda each: -each["seconds"])[:SLOWEST]
    lines += [f"  {each['seconds']:6.1f} s  {each['name']}" for each in slowest]
    reasons = Counter(each.get("note", "") for each in tests if each["outcome"] == SKIPPED)
    lines += [f"skipped {count}: {reason}" for reason, count in reasons.most_common()]
    lines.append(
        f"part {report['part']} on {report['device']}: {report['passed']} passed, {report['failed']} failed, "
        f"{report['skipped']} skipped, {report['units_not_ended']} of {len(report['units'])} units not ended; "
        f"{report['seconds']:.0f} s"
    )
    return "\n".join(lines)


def seconds_in(reports: Iterable[Path]) -> dict[str, float]:
    """Seconds by file of tests and by case, of units that ended: what another had is not all of it."""
    seconds: Counter = Counter()
    for path in reports:
        for unit in json.loads(path.read_text(encoding="utf-8"))["units"]:
            for each in unit["tests"] if unit["state"] == DONE else ():
                is_test = "::" in each["name"]
                name = each["name"].partition("::")[0] if is_test else each["name"].rpartition(" (")[0]
                seconds[name] += each["seconds"]
    return {name: round(value, 1) for name, value in seconds.items()}
