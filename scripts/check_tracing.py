#!/usr/bin/env python3
"""Check that RayBatch finds the right hits: millions of random and adversarial rays, against every tree and Warp's.
`check_tracing.py --help` says how.
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
Check RayBatch's tracers on FILE: geometry (.npz, arrays v and f), or a scene written by render.py --save-scene
(.scene.npz).

Rays are random, or aimed at what is rare: corners, edges, planes, axes, surfaces, far origins, tiny components,
directions of any length. Each is traced in every tree; hits must be the same bits. Further,
 - some rays are also tested against every triangle, without boxes: the same bits;
 - any hit and closest hit agree; a ray that ends at its hit meets nothing, one that ends behind it meets the same;
 - every hit lies on the triangle that it names, in float64, within the error bound of float32;
 - where Warp's tree disagrees, and for a sample where it does not, all triangles are asked in float64: an answer beyond
   the bound is a fault. Warp's faults are counted apart;
 - no ray escapes from inside a closed mesh (FILE's where it is closed, and a generated one).

The exit code is 1 if anything of RayBatch's own is wrong.
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    from checking.trees import TREES, TREES_DEFAULT

    parser = argparse.ArgumentParser(
        prog="check_tracing.py",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        epilog="trees:\n" + "\n".join(f"  {name:<18}{what}" for name, what in TREES.items()),
    )
    parser.add_argument("--scene", type=Path, required=True, metavar="FILE")
    parser.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
    parser.add_argument("--rays", default="10e6", metavar="N", help="default: %(default)s")
    parser.add_argument(
        "--leak-rays", default="1e8", metavar="N", help="from inside closed meshes, 0: none (default: %(default)s)"
    )
    parser.add_argument(
        "--instances", type=int, default=0, metavar="N", help="place the mesh N times more, under random affine maps"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the rays (default: 1)")
    parser.add_argument(
        "--trees",
        metavar="NAME[,NAME]",
        help=f"the first is compared with the others (default: {TREES_DEFAULT['cpu']} on the CPU, "
        f"{TREES_DEFAULT['cuda']} on CUDA)",
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="write the report as JSON; without FILE to standard output, and nothing else there",
    )
    parser.add_argument("--verbose", action="store_true", help="pass on what Warp prints, to standard error")
    return parser


def count_of(name: str, text: str, least: int) -> int:
    """A whole number such as 1000 or 10e6; raises `UsageError`."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (least <= value < 2**31 and value == int(value)):
        raise UsageError(f"{name} {text} is not valid: give a whole number, such as {10**6} or 1e6")
    return int(value)


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    from checking.check import CheckRequest, check_tracing
    from checking.report import report_text

    if options.json and options.json != "-":
        folders.prepare(Path(options.json).absolute())
    if not 0 <= options.instances <= 1000:
        raise UsageError(f"--instances {options.instances} is not valid: give 0 to 1000")
    report = check_tracing(
        CheckRequest(
            options.scene,
            options.device,
            count_of("--rays", options.rays, 1),
            count_of("--leak-rays", options.leak_rays, 0),
            options.seed,
            options.trees,
            options.instances,
        )
    )
    write_report(options.json, report, report_text(report), standard_output)
    return 1 if report["own_faults"] else 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("check_tracing.py", options.verbose, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
