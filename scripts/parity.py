#!/usr/bin/env python3
"""Compare every feature of materials, textures, lamps and worlds with Cycles. `parity.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import os
import sys
import time
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lib.command import run_command
from lib.output import OutputFolders, leave, write_json, write_text

from raybatch_addon.core.errors import RayBatchError

DESCRIPTION = """\
Render each feature of tests/blender/features with Cycles and with RayBatch, on the CPU, and compare.

A node alone is compared number by number at 1,024 points; a picture by the mean of each channel and by relMSE without
the noise. Without --only and --quick the table of all features is written, docs/parity.md with its sheets of pictures;
with --only and --out docs the rows of those features alone are written anew. The exit code is 0 whether features are
within bounds or not, and 1 if something else went wrong; --strict makes it 1 also when a feature is out of
bounds.
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="parity.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add(
        "--only",
        action="append",
        default=[],
        metavar="NAME[,NAME]",
        help="features of this name, of this family, or with this part in their names",
    )
    add("--quick", action="store_true", help="only the features that are compared with every change")
    add(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the report as JSON; without FILE to standard output, and nothing else there",
    )
    add(
        "--out",
        type=Path,
        metavar="DIR",
        help="write parity.md and its folder parity/ there (default: docs/, when all features are compared); the rows "
        "of\n"
        "features that are not compared this time stay as they are there",
    )
    add("--list", action="store_true", help="name the features, and compare none")
    add(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes side by side (default: one a core)",
    )
    add("--strict", action="store_true", help="exit with 1 if a feature is out of bounds")
    add("--verbose", action="store_true", help="pass on what Blender and Warp print, to standard error")
    add("--worker", type=Path, help=argparse.SUPPRESS)  # one process of many: where its results go
    add("--exactly", action="append", default=[], help=argparse.SUPPRESS)
    return parser


def work(options: argparse.Namespace) -> int:
    """One process of many."""
    import raybatch_addon

    raybatch_addon.register()
    from parity_report.workers import write_results

    from tests.blender.features.registry import all_features
    from tests.blender.features.runner import run

    results = []

    def done(result) -> None:
        results.append(result)
        write_results(results, options.worker)

    run([each for each in all_features() if each.name in options.exactly], done)
    return 0


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code."""
    if options.worker:
        return work(options)
    from parity_report.page import counts, json_report
    from parity_report.workers import run_groups

    from raybatch_addon.core.measure.statistics import versions
    from tests.blender.features.registry import chosen_features

    features = chosen_features([name for names in options.only for name in names.split(",")], options.quick)
    if options.list:
        for each in features:
            print(
                f"{each.family:10} {each.kind:8} {each.name}{'  (quick)' if each.quick else ''}", file=standard_output
            )
        return 0
    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    import bpy

    known = {"Blender": bpy.app.version_string, "Warp": versions()["warp"], "RayBatch": versions()["raybatch"]}
    whole = not (options.only or options.quick)
    out = options.out or (ROOT / "docs" if whole else None)
    started = time.perf_counter()

    def show(result) -> None:
        print(result.text(), file=sys.stderr, flush=True)
        if out:  # what was done is there if the rest is stopped
            _write_page(out, [result], known, standard_output)

    results = run_groups(features, Path(__file__).resolve(), options.jobs, show)
    seconds = time.perf_counter() - started
    if options.json:
        write_json(options.json, [json_report(results, known, seconds)], standard_output)
    for name, (ok, total) in counts(results).items():
        print(f"{name}: {ok} of {total} within bounds", file=sys.stderr)
    print(f"{seconds:.0f} s", file=sys.stderr)
    return int(options.strict and not all(result.ok for result in results))


def _write_page(out: Path, results: list, known: dict[str, str], standard_output) -> None:
    """`results` and the rows of other features that are in `out` already, as a page with its pictures and as JSON."""
    from parity_report.page import earlier_results, json_report, page, together
    from parity_report.sheets import write_sheets

    (out / "parity").mkdir(parents=True, exist_ok=True)
    stored = out / "parity" / "results.json"
    rows = together(earlier_results(stored), results)
    text = page(rows, write_sheets(rows, out / "parity"), known)
    write_text(out / "parity.md", text)
    write_json(str(stored), [json_report(rows, known, sum(row.seconds for row in rows))], standard_output)


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command(
        "parity.py", options.verbose, functools.partial(run, options), errors=(RayBatchError, LookupError)
    )


if __name__ == "__main__":
    leave(main())
