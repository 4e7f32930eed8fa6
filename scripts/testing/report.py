"""The facts that every report states about its own run."""

from __future__ import annotations

import argparse
import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from lib.output import write_report, write_text
from tables.marked_text import with_part

ROOT = Path(__file__).resolve().parents[2]
# written by the checks themselves: they do not make a checkout another one
_PAGES = ("docs/testing.json", "docs/testing.md")


def commit() -> str:
    """The commit of the checkout, with a + where files were changed; empty where there is no git."""
    try:
        found = subprocess.run(["git", "rev-parse", "--short=10", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        changed = subprocess.run(
            ["git", "status", "--porcelain", "--untracked-files=no", "--", ".", *(f":!{page}" for page in _PAGES)],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
    except OSError:
        return ""
    return found.stdout.strip() + ("+" if changed.stdout.strip() else "") if found.returncode == 0 else ""


def today() -> str:
    """The date and time, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


def of_chance(options: argparse.Namespace, start: float, **found: object) -> dict[str, Any]:
    """The report of a run on the CPU that drew what it did by `options.seed`, and began at `start` [s,
    `time.perf_counter`].
    """
    seconds = round(time.perf_counter() - start)
    return {"date": today(), "commit": commit(), "seed": options.seed, "seconds": seconds, **found}


def heading(report: dict[str, Any]) -> str:
    """One line over the tables of such a report."""
    return f"{report['date']}, commit {report['commit']}, seed {report['seed']}, {report['seconds']} s on the CPU."


def publish(
    options: argparse.Namespace, report: dict[str, Any], table: str, marks: tuple[str, str], standard_output: IO[str]
) -> None:
    """Write the report to `options.json`, and its `table` between `marks` of `options.page`, where these are given."""
    write_report(options.json, report, table, standard_output)
    if options.page:
        text = options.page.read_text(encoding="utf-8")
        write_text(options.page, with_part(text, *marks, table, options.page))
