#!/usr/bin/env python3
"""Render .blend files with Cycles and with RayBatch, and show how they differ. `compare.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lib.command import run_command
from lib.output import OutputFolders, leave

DESCRIPTION = """\
Render .blend files with Cycles and with RayBatch on the CPU, and report of each whether both show the same picture, how
long the first and the last picture took, how long each takes to the same error, and what RayBatch left out, by name.

Each engine renders each file in a process of its own, small, without clamping, adaptive sampling and denoising (or
with its own --defaults, but without denoising, since the noise of a denoised picture says nothing of its error). A file
that cannot be rendered is a row that says why. A scene without a camera is given one that sees all of it; where most of
a file's materials are on nothing, they are put on balls, twelve a sheet, and those that differ are named. Results are
written to --out as they come: results.json, report.html with its pictures, and the folder files/ of what was measured.
The same command goes on where it was stopped: only what is missing, failed, or was rendered by other code is rendered.
"""
EPILOG = """\
exit codes:
  0    every file was compared, whether the pictures are the same or differ
  1    some files could not be compared (each row says why), or something else went wrong, in one line
  2    the command line was not understood
  130  stopped from the keyboard; what was done is kept
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="compare.py",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("files", nargs="*", metavar="FILE", help=".blend files")
    add(
        "--list",
        type=Path,
        metavar="JSON",
        help="files of a list as docs/real-files.json; --folder says where they are",
    )
    add("--folder", type=Path, metavar="FOLDER", help="holds the files of --list as OWNER/NAME/PATH or OWNER+NAME/PATH")
    add("--only", action="append", default=[], metavar="PART", help="of --list: files with this in their names")
    add("--out", type=Path, default=Path("out/compare"), metavar="DIR", help="results (default: %(default)s)")
    add("--width", type=_positive, default=160, metavar="N", help="pixels (default: %(default)s)")
    add("--samples", type=_positive, default=32, metavar="N", help="of a pixel (default: %(default)s)")
    add(
        "--repeats",
        type=_positive,
        default=1,
        metavar="N",
        help="pairs of pictures with all samples, whose median is the time to equal error (default: %(default)s)",
    )
    add(
        "--defaults",
        action="store_true",
        help="render with each engine's own defaults instead of without clamping, adaptive sampling and the like",
    )
    add("--threads", type=int, default=0, metavar="N", help="of each engine (default: 0, one a core)")
    add(
        "--kernels",
        choices=("AUTO", "GENERAL", "SPECIALISED"),
        default="AUTO",
        help="RayBatch's setting Kernels: by AUTO a file that is new to it is rendered by general ones, if they are "
        "compiled; SPECIALISED ones are those of a file that was rendered for long before, and here the first picture "
        "waits for them (default: %(default)s)",
    )
    add(
        "--limit",
        type=float,
        default=600.0,
        metavar="SECONDS",
        help="of each step: opening a file, one render (default: %(default)g)",
    )
    add(
        "--superposition",
        action="store_true",
        help="report of files that differ which engine is right: render each lamp, the world and all surfaces that "
        "emit alone, and compare their sum with the picture of all; takes two renders for each",
    )
    add("--superposition-of-all", action="store_true", help="the same of all files")
    add(
        "--kernel-cache",
        metavar="FOLDER",
        help="begin each file with a copy of these compiled kernels, or with none: “cold” (default: the user's own)",
    )
    add(
        "--extension",
        type=Path,
        metavar="ZIP",
        help="render by the add-on in this extension (scripts/package.py makes it), with the kernels that are shipped "
        "in it, instead of this folder's; Blender and Warp are this environment's",
    )
    add("--again", action="store_true", help="render everything anew")
    add(
        "--table",
        action="store_true",
        help="write docs/real-files.md from what is in --out; without files nothing is rendered",
    )
    add(
        "--note", default="", metavar="TEXT", help="a sentence for the page: what a reader has to know of these results"
    )
    add("--worker", type=Path, help=argparse.SUPPRESS)  # one process of many: its request
    return parser


def _positive(text: str) -> int:
    count = int(text) if text.isdigit() else 0
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return count


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code."""
    if options.worker:
        from real_files.worker import work

        return work(options.worker)
    from real_files.comparison import compare

    return compare(options, ROOT, Path(__file__).resolve(), standard_output)


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    options = argument_parser().parse_args(arguments)
    return run_command("compare.py", False, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
