#!/usr/bin/env python3
"""Merge checkpoints of ranges of samples, rendered apart or on several machines. `merge.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path
from typing import IO

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from lib.command import UsageError, run_command
from lib.output import OutputFolders, film_arrays, leave, print_notes, write_film

DESCRIPTION = """\
Merge checkpoints of ranges of samples to one, bit for bit that of a render of all of them:

  render.py scene.blend --set sample_count=64 --checkpoint a.checkpoint
  render.py scene.blend --set sample_count=64 --sample-first 64 --checkpoint b.checkpoint     (on another machine)
  merge.py all.checkpoint a.checkpoint b.checkpoint
  render.py scene.blend --set sample_count=128 --checkpoint all.checkpoint -o picture.png     (no sample is rendered)

All must be of the same scene, settings, size and passes, from devices of one model. The ranges must adjoin.
The exit code is 0, or 1 with one line that says what was wrong (2: the command line was not understood).
"""


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="merge.py", description=DESCRIPTION, formatter_class=argparse.RawTextHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="the checkpoint of all samples; may be one of the files")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="checkpoints, in any order")
    parser.add_argument("--film", metavar="FILE.npz", help="write the linear passes too, as render.py --film does")
    return parser


def merge(options: argparse.Namespace, folders: OutputFolders, _standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    from raybatch_addon.core.checkpoint.merging import merged_films, range_of, save_merged

    if options.film and not options.film.lower().endswith(".npz"):
        raise UsageError(f"--film {options.film}: name it with the ending .npz, by which it is known later")
    for path in (options.out, options.film and Path(options.film)):
        if path:
            folders.prepare(path.absolute())
    merged = merged_films(options.files)
    save_merged(options.out, merged)
    samples = range_of(merged)
    print_notes([f"saved {options.out} with samples {samples.first} to {samples.end - 1} of each pixel"], "merge.py")
    if options.film:
        write_film(Path(options.film).absolute(), film_arrays([("", merged.film())]))
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    return run_command("merge.py", False, functools.partial(merge, argument_parser().parse_args(arguments)))


if __name__ == "__main__":
    leave(main())
