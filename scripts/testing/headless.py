#!/usr/bin/env python3
"""Try the command line of Blender's own program with RayBatch. `headless.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

for folder in Path(__file__).resolve().parents[1:3]:  # of the scripts, and of the package
    sys.path.insert(0, str(folder))

from lib.command import run_command
from lib.output import OutputFolders, leave, write_report

from testing.blender_program import BlenderProgram
from testing.headless_checks import CHECKS, HeadlessFiles, Wrong, make_files
from testing.page import write_page
from testing.report import commit, today

DESCRIPTION = """\
Start Blender's own program without a window, with RayBatch as its engine, once or more for each of its options, and
look at what it leaves: files, exit codes, lines of progress. RayBatch has to be installed and enabled there. The files
that it renders are made by that Blender. The exit code is 0, or 1 if something is not as it should be.
"""


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    blender = BlenderProgram(options.blender, options.limit)
    with tempfile.TemporaryDirectory(prefix="raybatch-headless-", dir=options.folder) as scratch:
        files = make_files(blender, Path(scratch), options.device)
        rows = [_row(name, files) for name in CHECKS if not options.only or name in options.only]
    report = {
        "date": today(),
        "commit": commit(),
        "blender": files.version,
        "seconds": round(sum(row["seconds"] for row in rows)),
        "rows": rows,
    }
    write_report(options.json, report, table_of(report), standard_output)
    if options.note:
        write_page([noted_row(report)])
    return int(any(row["wrong"] for row in rows))


def _row(name: str, files: HeadlessFiles) -> dict[str, Any]:
    """The result of a check."""
    print(f"headless.py: {name}", file=sys.stderr, flush=True)
    check: Callable[[HeadlessFiles], None] = CHECKS[name]
    start, wrong = time.monotonic(), ""
    try:
        check(files)
    except Wrong as error:
        wrong = str(error)
        print(f"headless.py: {name}: {wrong}", file=sys.stderr, flush=True)
    held = " ".join((check.__doc__ or "").split())
    return {"name": name, "held": held, "wrong": wrong, "seconds": round(time.monotonic() - start, 1)}


def table_of(report: dict[str, Any]) -> str:
    """The report as a table of Markdown."""
    rows = ["| of | what is held | seconds | |", "|---|---|---:|---|"]
    for row in report["rows"]:
        result = f"WRONG: {row['wrong']}" if row["wrong"] else "good"
        cells = (row["name"], row["held"], f"{row['seconds']:.0f}", result)
        rows.append("| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |")
    heading = f"{report['date']}, commit {report['commit']}, {report['blender']}, {report['seconds']} s."
    return "\n".join([heading, "", *rows])


def noted_row(report: dict[str, Any]) -> dict[str, Any]:
    """The report as a row of docs/testing.md."""
    wrong = [f"{row['name']}: {row['wrong']}" for row in report["rows"] if row["wrong"]]
    return {
        "check": "headless",
        "about": f"headless.py, by the program of {report['blender']}",
        **{name: report[name] for name in ("date", "commit", "seconds")},
        "passed": len(report["rows"]) - len(wrong),
        "failed": len(wrong),
        "skipped": 0,
        "failures": wrong,
    }


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="headless.py", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--blender", type=Path, required=True, metavar="PATH", help="Blender's program")
    add("--device", default="cpu", metavar="NAME", help="where RayBatch renders; default: cpu")
    add("--only", action="append", choices=list(CHECKS), metavar="NAME", help="only this; may be given several times")
    add("--folder", type=Path, metavar="DIR", help="where files are made meanwhile; default: that of the system")
    add("--limit", type=float, default=600.0, metavar="SECONDS", help="of a call of Blender at most; default: 600")
    add("--json", metavar="FILE", help="write the report as JSON too; - is standard output")
    add("--note", action="store_true", help="note the result in docs/testing.json and docs/testing.md")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    if options.note and options.only:
        argument_parser().error("--note is for all checks")
    return run_command("headless.py", False, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
