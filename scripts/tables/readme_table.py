#!/usr/bin/env python3
"""Make the README's table of real files from the figures of docs/studies/equal-error.md:

    python scripts/tables/readme_table.py

Run it after equal_error_table.py and gpu_slopes_table.py, which keep those figures.
"""

from __future__ import annotations

import json
import statistics
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from real_files.rows import EQUAL, VARIANCE

from tables import equal_error_table, gpu_slopes_table
from tables.equal_error_table import TIME, known_to_differ, row
from tables.marked_text import with_part, write_or_check

PAGE = ROOT / "README.md"
MARKS = "<!-- real files: made by scripts/tables/readme_table.py -->", "<!-- end of real files -->"
COLUMNS = (VARIANCE, TIME, EQUAL)
HEADS = ("", "noise", "time", "time to the same error", "worst file", "files")


def table(runs: list[dict[str, Any]], reports: list[dict[str, Any]]) -> str:
    """RayBatch over Cycles: the medians of each comparison, and the file that is worst at equal error, in all repeats.
    `runs` are what equal_error_table.py knows, `reports` what gpu_slopes_table.py keeps; files whose pictures differ do
    not count.
    """
    lines = [row(HEADS), row(["---"] * len(HEADS))]
    for run in runs:
        ratios = {name: [each[what] for what in COLUMNS] for name, each in run["files"].items() if each["same"]}
        lines.append(_line(f"two cores, {equal_error_table.asked(run['request'])}", ratios))
    differing = known_to_differ()
    names = (gpu_slopes_table.VARIANCE, gpu_slopes_table.SLOPE, gpu_slopes_table.EQUAL)
    groups = gpu_slopes_table.by_features([each for each in reports if each["scene"] not in differing])
    for what, same in zip(("surfaces alone", "volumes, hair, motion blur"), groups, strict=True):
        if same:
            device = same[0]["device"]["name"].removeprefix("NVIDIA ")
            ratios = {each["scene"]: [[each[name]] for name in names] for each in same}
            lines.append(_line(f"{device}, a sample, {what}", ratios))
    return "\n".join(lines)


def _line(title: str, ratios: dict[str, list[list[float]]]) -> str:
    """A row: `ratios` are those of each file, in the order of the columns, one for each repeat."""
    medians = [statistics.median(map(statistics.median, each)) for each in zip(*ratios.values(), strict=True)]
    worst = max(ratios, key=lambda name: max(ratios[name][-1]))
    worst_cell = f"{max(ratios[worst][-1]):.2f} ({Path(worst).stem})"
    return row([title, *(f"{each:.2f}" for each in medians), worst_cell, str(len(ratios))])


def updated(text: str) -> str:
    """The README with the table as it is now."""
    reports = json.loads(gpu_slopes_table.DATA.read_text(encoding="utf-8"))
    return with_part(text, *MARKS, table(equal_error_table.known(), reports), PAGE)


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(PAGE, updated, "scripts/tables/readme_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
