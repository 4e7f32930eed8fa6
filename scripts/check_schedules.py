#!/usr/bin/env python3
"""Check that no schedule changes a film: settings drawn at random, films compared bit for bit. `check_schedules.py
--help` says how.
"""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path
from typing import IO

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import UsageError, run_command
from lib.output import OutputFolders, leave, write_report

DESCRIPTION = """\
Check on each scene FILE (.scene.npz, written by render.py --save-scene) that settings which should change time alone
change no film.

A value is drawn for every one of them (but the device): batching, queues, treelets, launches, tiles, threads, geometry
beyond memory. The film is compared with the plain one, rendered without queues and with all else as by default: passes,
exact sums and counts of samples, bit for bit. Further, every ray that was taken in must have been finished once, and no
sample may be invalid. With few rays alive only a part of the frame is rendered, and compared with that part.

A budget of geometry that is too small is raised to what the message says is enough, and then must be enough.
The exit code is 1 if anything differs, or fails; the first time the settings are printed. --first N --count 1 repeats
schedule N.
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="check_schedules.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--scene", type=Path, required=True, nargs="+", metavar="FILE")
    parser.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
    parser.add_argument(
        "--count", type=int, default=200, metavar="N", help="schedules for each scene (default: %(default)s)"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="N", help="number of the first one (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the schedules (default: %(default)s)")
    parser.add_argument(
        "--size", type=int, default=64, metavar="PIXELS", help="the frame's longer side (default: %(default)s)"
    )
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="per pixel (default: %(default)s)")
    parser.add_argument("--bounces", type=int, metavar="N", help="instead of the scene's own")
    parser.add_argument(
        "--turns",
        type=int,
        default=24,
        metavar="N",
        help="waves of paths of a film at most, by a smaller part of the frame (default: %(default)s)",
    )
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting that is not drawn")
    parser.add_argument("--kernel-cache", metavar="FOLDER", help="where compiled kernels are kept")
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the report as JSON; without FILE to standard output, and nothing else there",
    )
    parser.add_argument("--verbose", action="store_true", help="pass on what Warp prints, to standard error")
    return parser


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    from checking.schedule_runs import ScheduleRequest, check_schedules, report_text

    for name, least in (("count", 1), ("first", 0), ("seed", 0), ("size", 1), ("samples", 1), ("turns", 1)):
        if getattr(options, name) < least:
            raise UsageError(f"--{name} {getattr(options, name)} is not valid: give {least} or more")
    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    report = check_schedules(
        ScheduleRequest(
            scenes=tuple(options.scene),
            device=options.device,
            count=options.count,
            first=options.first,
            seed=options.seed,
            size=options.size,
            samples=options.samples,
            bounces=options.bounces,
            turns=options.turns,
            fixed=tuple(options.set),
            kernel_cache=options.kernel_cache,
        )
    )
    write_report(options.json, report, report_text(report), standard_output)
    return 1 if report["faults"] else 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("check_schedules.py", options.verbose, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
