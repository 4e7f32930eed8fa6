"""The report of a part that was run on a GPU, complete or not."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lib.output import write_text

from testing.outcomes import FAILED, PASSED, SKIPPED, CheckOutcome
from testing.report import commit, today
from testing.run_units import BROKEN, DONE, RUNNING, STOPPED, WAITING, UnitRun

SLOWEST = 20  # tests and cases that are named


def report_of(runs: Sequence[UnitRun], part: tuple[int, int], device: str, seconds: float) -> dict[str, Any]:
    """All that is known now; `seconds` since the part began."""
    units, outcomes = [], []
    for run in runs:
        ended = run.outcomes
        outcomes += ended
        row = {
            "unit": run.unit.name,
            "state": run.state,
            "seconds": round(run.seconds, 1),
            "expected_seconds": round(run.unit.seconds, 1),
            "tests": [_row(each) for each in ended],
        }
        if run.state == BROKEN:
            row["printed"] = run.printed()
        units.append(row)
    counts = Counter(each.outcome for each in outcomes)
    states = Counter(run.state for run in runs)
    return {
        "date": today(),
        "commit": commit(),
        "part": "/".join(map(str, part)),
        "device": device,
        "cores": os.cpu_count(),
        "seconds": round(seconds, 1),
        "complete": states[DONE] == len(runs),
        "passed": counts[PASSED],
        "failed": counts[FAILED] + states[BROKEN],
        "skipped": counts[SKIPPED],
        "units_not_ended": states[WAITING] + states[RUNNING] + states[STOPPED],
        "units": units,
    }


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
