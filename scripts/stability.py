#!/usr/bin/env python3
"""Check that RayBatch gives right answers on stiff and extreme scenes. `stability.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import json
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
Run the cases of tests/stability: stiff and extreme scenes, each with an expected value and a bound on the error that is
derived beside it.

Each is run for the control (tracer off: every ray visits the whole tree at once) and with rays that wait at treelets
(tracer on), where the tracer can matter. A case passes when its error is within the tolerance and no sample was
invalid. The exit code is 1 if one fails.

The environment variable RAYBATCH_SCENES names a folder of larger scenes (.npz); cases that read one are skipped
without it.
"""
LEAK_RAYS_MOST = 2_000_000_000  # rays are numbered by 31 bits


def ray_count(text: str) -> int:
    """A whole number of rays, also as 1e8."""
    try:
        count = float(text)
    except ValueError:
        count = 0.0
    if not (1 <= count <= LEAK_RAYS_MOST and count == int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to {LEAK_RAYS_MOST:,}, such as 1e8")
    return int(count)


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="stability.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--quick", action="store_true", help="only the cases that are checked with every change, about a third"
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME[,NAME]",
        help="cases with this name, of this family, or with this part in their names",
    )
    parser.add_argument("--tracer", choices=("off", "on"), help="only this one")
    parser.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
    parser.add_argument(
        "--leak-rays",
        type=ray_count,
        default=0,
        metavar="N",
        help="how many rays each case of the family leaks traces with each tracer, such as 1e8 on a GPU; "
        "else 1e8 in all on a GPU, and on a CPU as many as fit in seconds",
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the report as JSON; without FILE to standard output, and nothing else there",
    )
    parser.add_argument("--html", metavar="FILE", help="write a page that stands alone")
    parser.add_argument("--list", action="store_true", help="name the cases, and run none")
    parser.add_argument(
        "--table",
        nargs="*",
        metavar="REPORT",
        help="write the tables of all cases in docs/stability.md, and run none; errors of each REPORT, a file by "
        "--json, are kept beside it",
    )
    parser.add_argument("--kernel-cache", metavar="FOLDER", help="where compiled kernels are kept")
    parser.add_argument("--verbose", action="store_true", help="pass on what Warp prints, to standard error")
    return parser


def write_tables(reports: list[Path]) -> None:
    """Keep the errors of `reports`, and write the tables of all cases in the manual."""
    from stability_report import manual

    from tests.stability.cases import all_cases

    results = manual.read_results(ROOT)
    for path in reports:
        try:
            results = manual.merged(results, manual.results_of(json.loads(path.read_text(encoding="utf-8"))))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RayBatchError(f"{path} is no report that stability.py --json wrote ({error})") from None
    page = manual.manual(ROOT)
    new = {page: manual.with_table(page.read_text(encoding="utf-8"), all_cases(), results)}
    if reports:
        new[manual.results_file(ROOT)] = manual.results_text(results)
    for path, text in new.items():
        path.parent.mkdir(exist_ok=True)
        write_text(path, text)


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code."""
    # here, so that --help is quick and what modules print when they are loaded stays away from standard output
    from benchmarking.progress import Steps
    from stability_report.page import html_page
    from stability_report.report import json_report, text_report, verdict

    from raybatch_addon.core.device.devices import device_description, find_device, start_warp
    from raybatch_addon.core.measure.statistics import versions
    from tests.stability.cases import Result, chosen_cases, run_cases
    from tests.support.running.kernel_builds import build_once

    if options.table is not None:
        write_tables([Path(name) for name in options.table])
        return 0
    cases = chosen_cases([name for names in options.only for name in names.split(",")], options.quick)
    if options.leak_rays and all(each.family != "leaks" for each in cases):
        raise RayBatchError(
            "--leak-rays is for the family leaks, of which no case was chosen: add it to --only, or leave --leak-rays "
            "out"
        )
    if options.list:
        for each in cases:
            named = ", ".join(each.tracers) if each.traces else "once"
            standard_output.write(f"{each.family}  {each.name}  ({named}{', quick' if each.quick else ''})\n")
        return 0
    for target in (options.json, options.html):
        if target and target != "-":
            folders.prepare(Path(target).absolute())
    start_warp(options.kernel_cache)
    build_once()
    device = device_description(find_device(options.device))
    tracers: tuple[str, ...] = (options.tracer, "-") if options.tracer else ("off", "on", "-")
    steps = Steps(sum(tracer in tracers for each in cases for tracer in each.tracers))
    results: list[Result] = []
    start = time.perf_counter()
    try:
        for event in run_cases(cases, str(device["alias"]), tracers, options.kernel_cache, options.leak_rays):
            if isinstance(event, Result):
                results.append(event)
                steps.end()
                if event.failed:
                    print(
                        f"{event.case.name} ({event.tracer}): {verdict(event)} {event.note}",
                        file=sys.stderr,
                        flush=True,
                    )
            else:
                steps.begin(f"{event[0].name} ({event[1]})")
    finally:
        steps.close()
    seconds = time.perf_counter() - start
    if options.json:
        write_json(options.json, [json_report(device, versions(), results, seconds)], standard_output)
    if options.html:
        page = html_page(results, device, versions(), seconds)
        write_text(Path(options.html).absolute(), page)
    if options.json != "-":
        standard_output.write(text_report(results, device, seconds) + "\n")
    return int(any(result.failed for result in results))


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("stability.py", options.verbose, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
