"""Run cases of tests/stability in this process.

run_cases.py [--tracer=off|on|-] DEVICE NAME [NAME ...]

A line for each case and tracer is written as `outcomes` says. The exit code is 1 if one fails.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from testing.outcomes import FAILED, PASSED, SKIPPED, CheckOutcome, write_outcome


def main(arguments: list[str]) -> int:
    """The exit code."""
    from tests.stability.cases import TRACERS, Result, all_cases, run_cases
    from tests.support.running.kernel_builds import build_once

    parser = argparse.ArgumentParser(prog="run_cases.py", allow_abbrev=False)
    parser.add_argument("--tracer", choices=TRACERS)
    parser.add_argument("device")
    parser.add_argument("names", nargs="+")
    given = parser.parse_args(arguments)
    build_once()
    failed = False
    cases = [each for each in all_cases() if each.name in given.names]
    for event in run_cases(cases, given.device, [given.tracer] if given.tracer else TRACERS):
        if isinstance(event, Result):
            outcome = SKIPPED if event.skipped is not None else PASSED if event.passed else FAILED
            found = event.outcome
            note = event.note if outcome != PASSED else ""
            if event.failed and found is not None:
                note += f" measured {found.measured!r}, expected {found.expected!r} within {found.tolerance!r}"
            if event.failed and event.invalid_samples:
                note += f" {event.invalid_samples} of {event.samples} samples were invalid"
            write_outcome(
                CheckOutcome(f"{event.case.name} ({event.tracer})", outcome, round(event.seconds, 2), note.strip())
            )
            failed |= event.failed
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
