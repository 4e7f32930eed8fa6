"""Write the README's table of whole renders from docs/figures: python scripts/tables/figures_table.py [--check]

The reports there are those of `scripts/benchmark.py render ... --json docs/figures/render-SCENE-DEVICE.json`. With
--check nothing is written, and the exit code is 1 where the table is not up to date.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from tables.marked_text import with_part, write_or_check

MANUAL = ROOT / "README.md"
FIRST, LAST = ("<!-- figures: made by scripts/tables/figures_table.py -->", "<!-- end of figures -->")


def row(path: Path) -> str:
    """One line of the table."""
    report = json.loads(path.read_text(encoding="utf-8"))
    ours, cycles = report["raybatch"], report.get("cycles")
    frame = report["frame"]
    rate = report["rays"]["total"] / ours["render"]["seconds"] / 1e6
    cells = [
        path.stem.split("-")[1].capitalize(),
        f"{report['triangles']:,}",
        report["device"]["name"],
        f"{frame['width']} x {frame['height']}, {report['samples_per_pixel']} spp",
        "" if report["export_s"] is None else f"{report['export_s']:.2f} s",
        f"{ours['build']['seconds']:.2f} s",
        f"{ours['render']['seconds']:.2f} s",
        f"{rate:.1f}",
        f"{ours['seconds']:.2f} s (±{50 * ours['spread']:.0f} %)",
        f"{cycles['seconds']:.2f} s (±{50 * cycles['spread']:.0f} %)" if cycles else "not measured",
        f"{report['raybatch_over_cycles']:.2f}" if cycles else "",
    ]
    return "| " + " | ".join(cells) + " |"


def figures_table() -> str:
    """A row for each report."""
    heads = [
        "scene",
        "triangles",
        "device",
        "picture",
        "export",
        "tree",
        "render",
        "Mrays/s",
        "whole",
        "Cycles, same CPU and run",
        "ratio",
    ]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    lines += [row(path) for path in sorted((ROOT / "docs/figures").glob("render-*.json"))]
    return "\n".join(lines)


def updated(text: str) -> str:
    """The page `text` with the table as it is now; raises `ValueError` where a mark is missing."""
    return with_part(text, FIRST, LAST, figures_table(), MANUAL)


def main(arguments: list[str]) -> int:
    """The exit code."""
    return write_or_check(MANUAL, updated, "scripts/tables/figures_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
