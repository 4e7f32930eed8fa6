#!/usr/bin/env python3
"""Run the studies of docs/studies: measurements that take turns, their figures, plots and tables.

A row is written to DIR/data/NAME-DEVICE.jsonl as soon as it is measured: a study that was cut short goes on when it is
started again. When all is there it becomes DIR/data/NAME-DEVICE.json, plots DIR/NAME-*.svg, and the tables between the
marks of DIR/NAME.md.

On a machine of its own (a GPU without the documents), measure with --out elsewhere, in parts if time is short, and
bring the rows home: study.py NAME --gather ROWS.jsonl ... makes figures, plots and tables of them.
"""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lib.command import UsageError, run_command
from lib.output import OutputFolders, leave

PAGES = ROOT / "docs/studies"


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="study.py", description=__doc__, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="of the study; --list names them")
    parser.add_argument("--list", action="store_true", help="name the studies, and end")
    parser.add_argument("--device", default="AUTO", help="AUTO, cpu or cuda:N")
    parser.add_argument("--quick", action="store_true", help="smaller scenes and fewer samples and turns")
    parser.add_argument(
        "--turns", type=int, metavar="N", help="measure everything N times (default: the study's own number)"
    )
    parser.add_argument(
        "--part", metavar="K/N", help="measure the Kth of N parts alone, of about the same number of cases"
    )
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="begin no measurement after S seconds; start again to go on"
    )
    parser.add_argument(
        "--scenes", metavar="DIR[:DIR]", help="folders of the scenes' archives (default: RAYBATCH_SCENES)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=PAGES,
        metavar="DIR",
        help="where figures, plots and page go (default: docs/studies)",
    )
    parser.add_argument("--fresh", action="store_true", help="forget what was measured, and measure all of it again")
    parser.add_argument("--cases", action="store_true", help="name what would be measured, and end")
    parser.add_argument(
        "--gather",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="measure nothing: make figures, plots and page of these rows",
    )
    parser.add_argument(
        "--draw",
        action="store_true",
        help="measure nothing: make plots and page of the figures that are there, and judge their slopes anew",
    )
    parser.add_argument("--no-plots", action="store_true", help="leave the plots out, which need matplotlib")
    parser.add_argument("--verbose", action="store_true", help="pass on what Blender and Warp print, to standard error")
    return parser


def parse_part(text: str | None) -> tuple[int, int] | None:
    """`K/N`; raises `UsageError`."""
    if text is None:
        return None
    parts = text.split("/")
    if len(parts) == 2 and all(each.isdecimal() for each in parts) and 1 <= int(parts[0]) <= int(parts[1]) <= 64:
        return int(parts[0]), int(parts[1])
    raise UsageError(f"--part {text} is not K/N with K from 1 to N, and N at most 64")


def run(given: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    from studies import runner
    from studies.registry import STUDIES, study_named
    from studies.rows import RowFile
    from studies.scenes import folders_of
    from studies.study import Options, part_of

    if given.list:
        standard_output.writelines(f"{study.name:16}{study.about}\n" for study in STUDIES.values())
        return 0
    if not given.name:
        raise UsageError(f"no study was named; the studies are {', '.join(STUDIES)}")
    study, part = study_named(given.name), parse_part(given.part)
    for name, value in (("turns", given.turns), ("seconds", given.seconds)):
        if value is not None and not value > 0:
            raise UsageError(f"--{name} {value} is not valid: it must be above 0")
    out = given.out.absolute()
    if given.gather:
        standard_output.write(f"{runner.publish(study, given.gather, out)}\n")
    if given.gather or given.draw:
        standard_output.write(f"{runner.write_page(study, out, not given.no_plots)}\n")
        return 0

    device = runner.device_of(given.device)
    kind = runner.kind_of(device)
    options = Options(
        device["alias"],
        given.quick,
        given.turns or study.turns[0 if given.quick else 1],
        folders_of(given.scenes),
        out / "cache",
        kind == "cuda",
    )
    cases = study.cases(options)
    mine = part_of(cases, *part) if part else cases
    if given.cases:
        standard_output.writelines(
            f"{case.key if case.key.startswith(case.group) else f'{case.group}: {case.key}'}\n" for case in mine
        )
        standard_output.write(f"{len(mine)} cases, {options.turns} turns\n")
        return 0
    path = runner.rows_path(out, study, kind, part)
    folders.prepare(path)
    if given.fresh:
        path.unlink(missing_ok=True)
    file = RowFile(path, runner.header_of(study, options, device))
    if not runner.measure(study, mine, options.turns, file, options, given.seconds):
        standard_output.write(
            f"{path}: {len(file.rows)} of {len(mine) * options.turns} rows are measured; start this again to go on\n"
        )
        return 0
    if part:
        standard_output.write(
            f"{path}: all {len(file.rows)} rows of part {given.part} are measured; bring the parts together with "
            "--gather\n"
        )
        return 0
    standard_output.write(f"{runner.publish(study, [path], out)}\n")
    path.unlink()
    try:
        standard_output.write(f"{runner.write_page(study, out, not given.no_plots)}\n")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the figures are written, but plots need {error.name}: install it and give --draw, or --no-plots"
        ) from None
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    given = argument_parser().parse_args(arguments)
    return run_command(
        "study.py", given.verbose, functools.partial(run, given), stopped="stopped; start it again to go on"
    )


if __name__ == "__main__":
    leave(main())
