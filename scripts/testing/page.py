"""The part of docs/testing.md that shows when everything was run last, and what came of it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from lib.output import write_text
from tables.marked_text import with_part

from testing.report import ROOT

PAGE = ROOT / "docs/testing.md"
STORED = ROOT / "docs/testing.json"
MARKS = ("<!-- last runs: made by scripts/testing/everything.py -->", "<!-- end of last runs -->")
FAILURES = 20  # names of failures that are kept of a check


def gpu_row(report: dict[str, Any]) -> dict[str, Any]:
    """A report of gpu.py as a row."""
    tests = [each for unit in report["units"] for each in unit["tests"]]
    failures = [each["name"] for each in tests if each["outcome"] == "failed"]
    failures += [unit["unit"] for unit in report["units"] if unit["state"] == "broken"]
    missing = report["units_not_ended"]
    left = f"; {missing} of {len(report['units'])} units did not end" if missing else ""
    return {
        "check": f"GPU {report['part']}",
        "about": f"tests without Blender and all of stability on {report['device']}{left}",
        **{name: report[name] for name in ("date", "commit", "seconds", "passed", "failed", "skipped")},
        "failures": failures,
    }


def stored_rows() -> list[dict[str, Any]]:
    """The last run of each check."""
    return json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else []


def table(rows: Iterable[dict[str, Any]]) -> str:
    """`rows` as a table in Markdown."""
    lines = [
        "| check | what | date | commit | seconds | passed | failed | skipped |",
        "|---|---|---|---|---:|---:|---:|---:|",
    ]
    failed = []
    for row in rows:
        cells = [row[name] for name in ("check", "about", "date", "commit")] + [f"{row['seconds']:,.0f}"]
        cells += [f"{row[name]:,}" for name in ("passed", "failed", "skipped")]
        lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
        failed += [f"- {row['check']}: {name}" for name in row["failures"]]
    if len(lines) == 2:
        return "Nothing was noted yet."
    return "\n".join(lines + (["", "Failed:", "", *failed] if failed else []))


def updated(text: str) -> str:
    """The page `text` with the table as it is stored; raises `ValueError` where a mark is missing."""
    return with_part(text, *MARKS, table(stored_rows()), PAGE)


def write_page(rows: Iterable[dict[str, Any]]) -> None:
    """Store `rows` over those of the same checks, and show all."""
    by_name = {row["check"]: row for row in stored_rows()}
    by_name |= {row["check"]: row | {"failures": row["failures"][:FAILURES]} for row in rows}
    write_text(STORED, json.dumps(list(by_name.values()), indent=1, ensure_ascii=False) + "\n")
    write_text(PAGE, updated(PAGE.read_text(encoding="utf-8")))
