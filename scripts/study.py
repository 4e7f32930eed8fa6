#!/usr/bin/env python3
"""Run the studies of docs/studies, or one of your own: measurements that take turns, their figures, plots and tables.

A study of your own is a file, FILE.toml, that names scenes, settings to vary, a control and what to measure
(docs/studies/own.md; docs/studies/own.toml is an example). All of it is checked before anything is rendered. Its page,
plots and rows go to --out, by default a folder beside the file that is called as it is; settings, cases, turns and
measures that are added later are measured then, and what was measured stays.

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
from typing import IO, TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lib.command import UsageError, run_command
from lib.output import OutputFolders, leave

if TYPE_CHECKING:
    from studies.study import Study

PAGES = ROOT / "docs/studies"


def argument_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="study.py", description=__doc__, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="of the study (--list names them), or a FILE.toml with one of your own"
    )
    parser.add_argument("--list", action="store_true", help="name the studies, and end")
    parser.add_argument("--device", help="AUTO, cpu or cuda:N (default: AUTO, or the devices of FILE.toml)")
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
        metavar="DIR",
        help="where figures, plots and page go (default: docs/studies; of FILE.toml the folder FILE beside it)",
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
    from studies.own.definition import is_own, read_definition
    from studies.own.study import own_study
    from studies.registry import STUDIES, study_named

    if given.list:
        standard_output.writelines(f"{study.name:16}{study.about}\n" for study in STUDIES.values())
        return 0
    if not given.name:
        raise UsageError(f"no study was named; the studies are {', '.join(STUDIES)}")
    devices: tuple[str, ...] = (given.device or "AUTO",)
    out = given.out or PAGES
    if is_own(given.name):
        if given.quick:
            raise UsageError("--quick is for the studies of the project: give your own fewer samples or turns")
        path = Path(given.name)
        defined = read_definition(path)
        study, out = own_study(defined, not given.no_plots), given.out or path.with_suffix("")
        devices = devices if given.device else defined.devices
    else:
        study = study_named(given.name)
    parse_part(given.part)
    for name, value in (("turns", given.turns), ("seconds", given.seconds)):
        if value is not None and not value > 0:
            raise UsageError(f"--{name} {value} is not valid: it must be above 0")
    out = out.absolute()
    if given.gather:
        standard_output.write(f"{runner.publish(study, given.gather, out)}\n")
    if given.gather or given.draw:
        standard_output.write(f"{runner.write_page(study, out, not given.no_plots)}\n")
        return 0
    for device in devices:
        runner.device_of(device)  # before time is spent on another
    whole = [measure_on(study, device, out, given, folders, standard_output) for device in devices]
    if not all(whole):
        return 0
    try:
        standard_output.write(f"{runner.write_page(study, out, not given.no_plots)}\n")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the figures are written, but plots need {error.name}: install it and give --draw, or --no-plots"
        ) from None
    return 0


def measure_on(
    study: Study, device: str, out: Path, given: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]
) -> bool:
    """Measure a study on a device, and say where the figures are; returns whether a page can be made of them. Raises
    `RayBatchError`.
    """
    from studies import runner
    from studies.scenes import folders_of

    part = parse_part(given.part)
    run = runner.run_of(
        study, device, out, quick=given.quick, turns=given.turns, scenes=folders_of(given.scenes), part=part
    )
    if given.cases:
        standard_output.writelines(
            f"{case.key if case.key.startswith(case.group) else f'{case.group}: {case.key}'}\n" for case in run.cases
        )
        standard_output.write(f"{len(run.cases)} cases, {run.options.turns} turns\n")
        return False
    folders.prepare(run.path)
    if given.fresh:
        run.path.unlink(missing_ok=True)
    if not run.measured(given.seconds):
        standard_output.write(
            f"{run.path}: {run.rows_there()} of {run.rows_wanted} rows are measured; start this again to go on\n"
        )
        return False
    if part:
        standard_output.write(
            f"{run.path}: all {run.rows_wanted} rows of part {given.part} are measured; bring the parts together with "
            "--gather\n"
        )
        return False
    standard_output.write(f"{runner.publish(study, [run.path], out)}\n")
    if not study.definition:  # of one's own more may be asked for
        run.path.unlink()
    return True


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    given = argument_parser().parse_args(arguments)
    return run_command(
        "study.py", given.verbose, functools.partial(run, given), stopped="stopped; start it again to go on"
    )


if __name__ == "__main__":
    leave(main())
