#!/usr/bin/env python3
"""Run everything there is on the CPU, and note it in docs/testing.md. `everything.py --help` says how."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.output import write_text

from testing.checks import CHECKS, Check
from testing.page import gpu_row, write_page
from testing.report import commit, today

DESCRIPTION = """\
Run the whole suite, all cases of stability, all features of parity, and short forms of check_tracing and
check_schedules, one after another, on the CPU: some hours. What was done is kept in out/testing/ and noted in
docs/testing.json and docs/testing.md. Run again, it goes on with the checks that have no result of this commit.

The exit code is 1 if something failed.
"""
WORK = ROOT / "out/testing"
STATE = WORK / "everything.json"


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="everything.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--only", action="append", choices=list(CHECKS), help="only this check; may be given several times")
    add("--again", action="store_true", help="also checks that have a result of this commit")
    add("--gpu-reports", nargs="+", type=Path, metavar="FILE", help="run nothing: note these reports of gpu.py")
    return parser


def run_check(name: str, check: Check) -> dict[str, Any]:
    """Run a check; its result as docs/testing.json keeps it."""
    print(f"{name}: {check.about}", file=sys.stderr, flush=True)
    WORK.mkdir(parents=True, exist_ok=True)
    check.prepare(WORK)
    start = time.monotonic()
    done = subprocess.run([sys.executable, *check.arguments(WORK)], cwd=ROOT, stdin=subprocess.DEVNULL)
    seconds = time.monotonic() - start
    row: dict[str, Any] = {"check": name, "about": check.about, "date": today(), "commit": commit()}
    row |= {"seconds": round(seconds, 1), "exit_code": done.returncode}
    try:
        row |= check.counts(WORK)
    except (OSError, ValueError, KeyError) as error:  # it ended before it wrote its report
        row |= {"passed": 0, "failed": 1, "skipped": 0, "failures": [f"no report: {error}"]}
    if done.returncode and not row["failed"]:
        row |= {"failed": 1, "failures": [f"exit code {done.returncode}"]}
    return row


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    if options.gpu_reports:
        write_page([gpu_row(json.loads(path.read_text(encoding="utf-8"))) for path in options.gpu_reports])
        return 0
    state = json.loads(STATE.read_text(encoding="utf-8")) if STATE.exists() else {}
    rows = []
    for name in options.only or CHECKS:
        row = state.get(name)
        if options.again or row is None or row["commit"] != commit():
            row = state[name] = run_check(name, CHECKS[name])
            write_text(STATE, json.dumps(state, indent=1) + "\n")
            write_page([row])
        rows.append(row)
        counts = ", ".join(f"{row[each]} {each}" for each in ("passed", "failed", "skipped"))
        print(f"{name}: {counts}; {row['seconds']:.0f} s ({row['date']})")
        for failure in row["failures"]:
            print(f"  FAILED {failure}")
    return int(any(row["failed"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
