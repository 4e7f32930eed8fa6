#!/usr/bin/env python3
"""Make the tables of docs/studies/equal-error.md from results of compare.py:

    python scripts/tables/equal_error_table.py [OUT...]

Each OUT is a folder that `compare.py --out` made, with a width, samples, repeats or defaults of its own. Their figures
are kept in docs/studies/data/equal-error.json; without an OUT the tables are made from that.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from lib.output import json_text, write_text
from real_files.listing import names_that_ask, names_that_differ, read_listing
from real_files.measures import Spread
from real_files.rows import BLACK, EQUAL, SAME, VARIANCE

from tables.marked_text import with_part, write_or_check

PAGE = ROOT / "docs" / "studies" / "equal-error.md"
DATA = ROOT / "docs" / "studies" / "data" / "equal-error.json"
LISTING = ROOT / "docs" / "real-files.json"
_KERNELS = {"SPECIALISED": ", kernels of the file compiled", "GENERAL": ", general kernels"}
MARKS = "<!-- equal error: made by scripts/tables/equal_error_table.py -->", "<!-- end of equal error -->"
TIME = "time"
WIDTH = 160  # pixels: what the page takes for granted; others are stated
HEADS = ("", *(f"{name}, {what}" for name in (VARIANCE, TIME, EQUAL) for what in ("median", "worst")), "files")


def kept(report: dict[str, Any]) -> dict[str, Any]:
    """What is kept of a results.json of compare.py: of each file that both engines rendered its ratios, RayBatch over
    Cycles, a list with one for each repeat.
    """
    files = {}
    for row in report["files"]:
        if not row.get("repeats", {}).get(EQUAL):
            continue
        seconds = row["seconds"]
        files[row["name"]] = {
            VARIANCE: row["repeats"][VARIANCE],
            EQUAL: row["repeats"][EQUAL],
            TIME: [e / v if v else None for e, v in zip(row["repeats"][EQUAL], row["repeats"][VARIANCE], strict=True)],
            "seconds": {engine: seconds[engine].get("all-2") for engine in seconds},
            "same": row["verdict"] in (SAME, BLACK),
            "left_out": len(row["left_out"]),
        }
    request = report["request"]
    rendered = {name: request.get(name) for name in ("width", "samples", "repeats", "defaults", "kernels")}
    return {"request": rendered, "versions": report["versions"], "note": report["note"], "files": files}


def known_to_differ() -> set[str]:
    """Names of files whose pictures differ by the list of real files: their figures do not count."""
    return names_that_differ(read_listing(LISTING))


def known() -> list[dict[str, Any]]:
    """What is kept of each run; files that are known to differ do, even where noise hid it."""
    differing = known_to_differ()
    data = json.loads(DATA.read_text(encoding="utf-8"))
    for run in data:
        for name, each in run["files"].items():
            each["same"] &= name not in differing
    return data


def tables(data: list[dict[str, Any]]) -> str:
    """Medians and the worst over all files, then each file."""
    lines = [row(HEADS), row(["---"] * len(HEADS))]
    for run in data:
        for title, files in _groups(run["files"]).items():
            if files:
                lines.append(row([f"{asked(run['request'])}: {title}", *_medians(files), str(len(files))]))
    names = sorted({name for run in data for name in run["files"]}, key=str.lower)
    heads = ["file", *(f"{asked(run['request'])}: {what}" for run in data for what in (VARIANCE, TIME, EQUAL))]
    lines += ["", row(heads), row(["---"] * len(heads))]
    for group in ("same picture", "another picture"):
        for name in names:
            found = [run["files"].get(name) for run in data]
            if (group == "same picture") != all(each["same"] for each in found if each):
                continue
            cells = [_cell(each, what) for each in found for what in (VARIANCE, TIME, EQUAL)]
            lines.append(row([name + (" (differs)" if group == "another picture" else ""), *cells]))
    notes = [f"- {asked(run['request'])}: {run['note']}" for run in data if run["note"]]
    return "\n".join([*lines, *([""] if notes else []), *notes])


def _groups(files: dict[str, dict]) -> dict[str, dict[str, dict]]:
    """All that are the same picture, those of them that ask for surfaces alone and for more, those of which nothing is
    left out, and those that differ.
    """
    same = {name: each for name, each in files.items() if each["same"]}
    more = names_that_ask(read_listing(LISTING))
    return {
        "same picture": same,
        "of these, surfaces alone": {name: each for name, each in same.items() if name not in more},
        "of these, volumes, hair, motion blur, ray portals": {name: same[name] for name in same if name in more},
        "of these, nothing left out": {name: each for name, each in same.items() if not each["left_out"]},
        "differ": {name: each for name, each in files.items() if not each["same"]},
    }


def _medians(files: dict[str, dict]) -> list[str]:
    """The median of each ratio with its interval, and the worst: the largest of all repeats."""
    cells = []
    for what in (VARIANCE, TIME, EQUAL):
        spread = Spread.of({name: statistics.median(each[what]) for name, each in files.items()})
        assert spread is not None  # there are files
        worst = max(files, key=lambda name: max(files[name][what]))
        cells.append(f"{spread.median:.2f} ({spread.low:.2f} to {spread.high:.2f})")
        cells.append(f"{max(files[worst][what]):.2f} ({worst.rpartition('/')[2]})")
    return cells


def _cell(found: dict[str, Any] | None, what: str) -> str:
    if found is None:
        return "-"
    values = found[what]
    worst = f" (to {max(values):.3g})" if len(values) > 1 else ""
    return f"{statistics.median(values):.3g}{worst}"


def asked(request: dict[str, Any]) -> str:
    """What was rendered, in words: samples, and what is not as usual."""
    width = f", {request['width']} pixels wide" * (request["width"] != WIDTH)
    own = ", own defaults" * bool(request["defaults"])
    return f"{request['samples']} samples{width}{own}" + _KERNELS.get(request.get("kernels") or "AUTO", "")


def row(cells: Iterable[str]) -> str:
    """A line of a table."""
    return f"| {' | '.join(cells)} |"


def updated(text: str) -> str:
    """The page with the tables as they are now."""
    return with_part(text, *MARKS, tables(known()), PAGE)


def main(arguments: list[str]) -> int:
    """The exit code."""
    folders = [Path(each) for each in arguments if each != "--check"]
    if folders:
        reports = [json.loads((folder / "results.json").read_text(encoding="utf-8")) for folder in folders]
        write_text(DATA, json_text([kept(each) for each in reports]) + "\n")
    return write_or_check(PAGE, updated, "scripts/tables/equal_error_table.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
