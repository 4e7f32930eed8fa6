"""Results of the suite: as JSON, and as a table for the terminal."""

from __future__ import annotations

import math
import textwrap
from typing import Any

from tests.stability.cases import Result

_SLOW = 10.0  # seconds of a case for one tracer, beyond which it is named
_NOTE_WIDTH = 100


def json_number(value: float) -> float | None:
    """`value`, or None where it is not finite: JSON has no other numbers."""
    return float(value) if math.isfinite(value) else None


def json_report(
    device: dict[str, Any], versions: dict[str, str], results: list[Result], seconds: float
) -> dict[str, Any]:
    """All that was measured; `device` and `versions` are what ran."""
    cases = []
    for result in results:
        if result.skipped is not None:
            continue
        outcome = result.outcome
        cases.append(
            {
                "name": result.case.name,
                "tracer": result.tracer,
                "passed": result.passed,
                "measured": json_number(outcome.measured) if outcome else None,
                "expected": json_number(outcome.expected) if outcome else None,
                "tolerance": json_number(outcome.tolerance) if outcome else None,
                "invalid_samples": result.invalid_samples,
                "samples": result.samples,
                "seconds": round(result.seconds, 3),
                "seconds_compiling": round(result.compiling, 3),  # of processors: several may compile at once
                "family": result.case.family,
                "about": result.case.about,
                "bound": result.case.bound,
                "note": result.note,
            }
        )
    skipped = [{"name": r.case.name, "tracer": r.tracer, "reason": r.skipped} for r in results if r.skipped is not None]
    return {
        "device": device["name"],
        "cases": cases,
        "skipped": skipped,
        "passed": sum(r.passed for r in results),
        "failed": sum(r.failed for r in results),
        "seconds": round(seconds, 3),
        "machine": device,
        "versions": versions,
    }


def number(value: float) -> str:
    """Nine digits: differences of float32 are visible."""
    return f"{value:.9g}"


def used(result: Result) -> str:
    """How much of the tolerance the error took."""
    if result.outcome is None:
        return ""
    error = (
        0.0
        if result.outcome.measured == result.outcome.expected
        else abs(result.outcome.measured - result.outcome.expected)
    )
    if result.outcome.tolerance == 0 or not math.isfinite(error):
        return "exact" if error == 0 else "wrong"
    return f"{100 * error / result.outcome.tolerance:.3g} %"


def verdict(result: Result) -> str:
    """The verdict on a run in one word."""
    return "skipped" if result.skipped is not None else "passed" if result.passed else "FAILED"


def text_report(results: list[Result], device: dict[str, Any], seconds: float) -> str:
    """A row for each run, what went wrong, and what was slow."""
    head = ("case", "tracer", "", "measured", "expected", "tolerance", "used", "invalid", "seconds")
    rows: list[tuple[str, ...]] = [head]
    for result in results:
        found = result.outcome
        numbers = [number(x) for x in (found.measured, found.expected, found.tolerance)] if found else [""] * 3
        reported = (used(result), str(result.invalid_samples), f"{result.seconds:.1f}")
        rows.append((result.case.name, result.tracer, verdict(result), *numbers, *reported))
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = [f"{device['name']} ({device['alias']})"]
    family = None
    for of_row, row in zip([None, *results], rows):
        if of_row is not None and of_row.case.family != family:
            family = of_row.case.family
            lines += ["", family]
        cells = [cell.ljust(width) if i < 3 else cell.rjust(width) for i, (cell, width) in enumerate(zip(row, widths))]
        lines.append("  " + "  ".join(cells).rstrip())
    for result in results:
        if result.failed:
            lines += ["", f"FAILED: {result.case.name} ({result.tracer}): {result.case.about}"]
            lines += textwrap.wrap(result.note, _NOTE_WIDTH, initial_indent="  ", subsequent_indent="  ")
            lines += textwrap.wrap(
                f"bound: {result.case.bound}", _NOTE_WIDTH, initial_indent="  ", subsequent_indent="  "
            )
            if result.invalid_samples:
                lines.append(f"  {result.invalid_samples:,} of {result.samples:,} samples were invalid")
    for name, reason in sorted({(r.case.name, r.skipped) for r in results if r.skipped is not None}):
        lines += ["", f"skipped: {name}: {reason}"]
    slow = [f"{r.case.name} ({r.tracer}) {r.seconds:.0f} s" for r in results if r.seconds > _SLOW]
    if slow:
        lines += [
            "",
            *textwrap.wrap(f"slow, compilation included: {', '.join(slow)}", _NOTE_WIDTH, subsequent_indent="  "),
        ]
    passed, failed = sum(r.passed for r in results), sum(r.failed for r in results)
    skipped = len(results) - passed - failed
    lines += [
        "",
        "used: share of the tolerance that the error took; tracer -: run once, with none or with several of its own",
    ]
    lines += [
        "",
        f"{passed} passed, {failed} failed, {skipped} skipped; {len({r.case.name for r in results})} cases, "
        f"{seconds:.0f} s",
    ]
    return "\n".join(lines)
