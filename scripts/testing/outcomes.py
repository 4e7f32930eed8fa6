"""Outcomes of tests and cases: a line of JSON for each, written as it ends, so that a killed run leaves what is done.

As a plugin of pytest (`-p testing.outcomes`) it writes a line for each test to the file of `FILE_VARIABLE`, and leaves
out what is not in the share of `SHARE_VARIABLE`: `2/3` is the second third of the tests, in their order, since
neighbours share kernels.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

FILE_VARIABLE = "RAYBATCH_OUTCOMES"
SHARE_VARIABLE = "RAYBATCH_SHARE"
PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
NOTE_LENGTH = 2000  # characters of a failure that are kept: its end


@dataclass(frozen=True)
class CheckOutcome:
    """One test, or one case with one tracer."""

    name: str
    outcome: str  # PASSED, FAILED or SKIPPED
    seconds: float
    note: str = ""  # why it failed, or was skipped


def write_outcome(outcome: CheckOutcome) -> None:
    """Add a line to the file of `FILE_VARIABLE`."""
    with open(os.environ[FILE_VARIABLE], "a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(outcome)) + "\n")


def read_outcomes(path: Path) -> list[CheckOutcome]:
    """The lines that are whole; none where there is no file."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")[:-1]  # the last one may be half written
    return [CheckOutcome(**json.loads(line)) for line in lines]


def share_of(count: int, share: str) -> range:
    """Indices of `count` things that are in `share`, such as 2/3."""
    number, total = map(int, share.split("/"))
    return range(count * (number - 1) // total, count * number // total)


def pytest_collection_modifyitems(config, items):
    """Leave out what other processes run."""
    share = os.environ.get(SHARE_VARIABLE)
    if share:
        mine = share_of(len(items), share)
        config.hook.pytest_deselected(items=[item for i, item in enumerate(items) if i not in mine])
        items[:] = [items[i] for i in mine]


def pytest_collectreport(report):
    """A file that cannot be read is a failure."""
    if report.failed:
        write_outcome(CheckOutcome(report.nodeid, FAILED, 0.0, str(report.longrepr)[-NOTE_LENGTH:]))


def pytest_runtest_logreport(report):
    """One line a test: its call, or what kept it from being called, or what failed behind it."""
    if report.when == "call" or (report.when == "setup" and not report.passed) or report.failed:
        note = ""
        if report.skipped:
            note = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        elif report.failed:
            note = str(report.longrepr)[-NOTE_LENGTH:]
        write_outcome(CheckOutcome(report.nodeid, report.outcome, round(report.duration, 2), note))
