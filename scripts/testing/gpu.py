#!/usr/bin/env python3
"""Run on a CUDA device what needs no Blender. `gpu.py --help` says how."""

from __future__ import annotations

import argparse
import importlib.util
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

DESCRIPTION = """\
Run the tests of tests/core and tests/renders, among them those that compare films of random schedules bit for bit, and
all cases of tests/stability on a CUDA device, from an empty kernel cache.

It needs Python 3.11 or newer with numpy, warp-lang, pytest and hypothesis, and neither Blender nor a network.

The work is cut into parts, always alike: --part 1/3, 2/3 and 3/3 together are everything. FILE is written whenever
something ends, so that a run that is killed leaves what was done. The exit code is 0 if all of the part was run and
nothing failed, 1 if not, and 2 if it could not begin.
"""
MOST_JOBS = 16  # by default: each holds some GB of the device
NEEDED = ("numpy", "warp", "pytest", "hypothesis")


def part(text: str) -> tuple[int, int]:
    """I/N."""
    number, _, count = text.partition("/")
    if not (number.isdigit() and count.isdigit() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a part such as 1/2")
    return int(number), int(count)


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="gpu.py", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add = parser.add_argument
    add("--part", type=part, default=(1, 1), metavar="I/N", help="part I of N (default: 1/1)")
    add("--out", type=Path, default=ROOT / "out/testing/gpu.json", metavar="FILE", help="default: out/testing/gpu.json")
    add(
        "--device",
        default=os.environ.get("RAYBATCH_TEST_DEVICE", "cuda:0"),
        help="default: that of RAYBATCH_TEST_DEVICE, else cuda:0",
    )
    add(
        "--jobs",
        type=int,
        default=min(os.cpu_count() or 1, MOST_JOBS),
        metavar="N",
        help=f"processes that share the device (default: one for each core, at most {MOST_JOBS})",
    )
    add("--limit", type=float, default=525.0, metavar="SECONDS", help="end then (default: %(default)g)")
    add("--kernel-cache", type=Path, metavar="FOLDER", help="where compiled kernels are kept (default: an empty one)")
    add("--after", type=Path, metavar="FILE", help="go on from this report: what passed there is not run again")
    add("--only", action="append", default=[], metavar="TEXT", help="only units with this in their names")
    add("--list", action="store_true", help="name the units of the part with the seconds expected, and run none")
    add(
        "--store-seconds",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="run nothing: keep the seconds in these reports, by which parts are cut",
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        print(f"gpu.py: error: {', '.join(missing)} cannot be imported; --help says what is needed", file=sys.stderr)
        return 2
    from testing.gpu_report import NOTHING_EARLIER, Earlier, report_of, seconds_in, summary, write_report
    from testing.run_units import UnitRun, run_units
    from testing.units import all_units, part_of, store_seconds

    if options.store_seconds:
        store_seconds(seconds_in(options.store_seconds))
        return 0
    try:
        earlier = Earlier.of(options.after, options.part) if options.after else NOTHING_EARLIER
    except ValueError as error:
        print(f"gpu.py: error: {error}", file=sys.stderr)
        return 2
    units = [
        unit
        for unit in part_of(all_units(), *options.part)
        if unit.name not in earlier.names and (not options.only or any(text in unit.name for text in options.only))
    ]
    if options.list:
        for unit in units:
            print(f"{unit.seconds:6.1f}  {unit.name}")
        print(f"{sum(unit.seconds for unit in units):6.1f}  in all, {len(units)} units")
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that processes end with this one
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="raybatch-gpu-") as folder:
        runs = UnitRun.of(units, Path(folder))
        kernels = options.kernel_cache or Path(folder) / "kernels"

        def write() -> dict:
            report = report_of(runs, options.part, options.device, time.monotonic() - start, earlier)
            write_report(options.out, report)
            return report

        run_units(runs, options.device, kernels.absolute(), options.jobs, start + options.limit, write)
        report = write()
    print(summary(report))
    return int(not report["complete"] or report["failed"] > 0)


if __name__ == "__main__":
    sys.exit(main())
