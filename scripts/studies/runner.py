"""Runs the measurements of a study in turns, and makes its report, plots and page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarking.progress import Steps
from converging.reference import core_digest
from lib.command import UsageError

from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import device_description, find_device, start_warp
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.measure.statistics import versions
from studies.bench import Bench, refused
from studies.curves import judge_anew
from studies.pages import put_fragment
from studies.rows import RowFile, gathered, read_report, write_report
from studies.scenes import FILES, find_all
from studies.study import Case, Options, Report, Study, groups_of, part_of

DATA = "data"  # folder beside the pages
CORE_LETTERS = 8  # of the digest of the engine's code that a row was measured with


def device_of(name: str) -> dict[str, Any]:
    """What the device `name` is, as statistics state it; raises `DeviceError`."""
    start_warp(kernel_cache_folder())
    return device_description(find_device(name))


def kind_of(device: dict[str, Any]) -> str:
    """`cpu` or `cuda`: what files are called by."""
    return "cuda" if device["alias"].startswith("cuda") else "cpu"


@dataclass(frozen=True)
class Run:
    """What is to be measured of a study on one device."""

    study: Study
    options: Options
    device: dict[str, Any]  # as statistics state it
    cases: list[Case]
    path: Path  # of the rows

    @property
    def rows_wanted(self) -> int:
        """How many rows there are when all is measured."""
        return len(self.cases) * self.options.turns

    def _rows(self) -> RowFile:
        return RowFile(self.path, header_of(self.study, self.options, self.device))

    def rows_there(self) -> int:
        """How many of them are measured."""
        file = self._rows()
        return sum(file.has(case.key, turn) for case in self.cases for turn in range(self.options.turns))

    def measured(self, seconds: float | None = None) -> bool:
        """Measure what the file of rows does not have; returns whether all is there. See `measure`."""
        return measure(self.study, self.cases, self.options.turns, self._rows(), self.options, seconds)


def run_of(
    study: Study,
    device_name: str,
    out: Path,
    *,
    quick: bool = False,
    turns: int | None = None,
    scenes: tuple[Path, ...] = (),
    part: tuple[int, int] | None = None,
) -> Run:
    """What a study measures on a device, or a `part` of it; raises `RayBatchError`."""
    device = device_of(device_name)
    kind = kind_of(device)
    turns = turns or study.turns[0 if quick else 1]
    # references that are made with other settings of a study are kept apart
    options = Options(device["alias"], quick, turns, scenes, out / "cache" / study.definition, kind == "cuda")
    cases = study.cases(options)
    return Run(study, options, device, part_of(cases, *part) if part else cases, rows_path(out, study, kind, part))


def measure(
    study: Study, cases: Sequence[Case], turns: int, file: RowFile, options: Options, seconds: float | None = None
) -> bool:
    """Measure what `file` does not have yet; returns whether all is there. Begins nothing after so many `seconds`."""
    left = [
        (turn, case)
        for group in groups_of(cases).values()
        for turn in range(turns)
        for case in group
        if not file.has(case.key, turn)
    ]
    if not left:
        return True
    names = dict.fromkeys(str(case.what.get("scene", "")).split(":")[0] for _, case in left)
    find_all([name for name in names if name in FILES], options)  # before time is spent on any
    steps, began = Steps(len(left)), time.perf_counter()
    bench = Bench(options)
    try:
        for turn, case in left:
            if seconds is not None and time.perf_counter() - began > seconds:
                return False
            steps.begin(f"{case.key}, turn {turn + 1} of {turns}")
            try:
                row = study.measure(case, turn, bench)
            except UsageError:  # what is asked for cannot be measured at all
                raise
            except RayBatchError as error:
                row = refused(error)
            file.add({"case": case.key, "turn": turn, **row, **case.what, "core": core_digest()[:CORE_LETTERS]})
            steps.end()
    finally:
        steps.close()
        bench.close()
    return True


def header_of(study: Study, options: Options, device: dict[str, Any]) -> dict[str, Any]:
    """What a file of rows begins with."""
    return {
        "study": study.name,
        "device_kind": kind_of(device),
        "quick": options.quick,
        "device": device,
        "versions": versions(),
        **({"definition": study.definition} if study.definition else {}),
    }


def rows_path(out: Path, study: Study, kind: str, part: tuple[int, int] | None) -> Path:
    """The file of rows of a study, or of a part of it."""
    suffix = f".part-{part[0]}-of-{part[1]}" if part else ""
    return out / DATA / f"{study.name}-{kind}{suffix}.jsonl"


def publish(study: Study, files: Sequence[Path], out: Path) -> Path:
    """Write the report of `files` (rows of one device); returns where."""
    report = gathered(files)
    if report["study"] != study.name:
        raise UsageError(f"{files[0]} holds rows of the study {report['study']}, not of {study.name}")
    path = _data_path(study, report["device_kind"], out)
    write_report(path, report)
    return path


def _data_path(study: Study, kind: str, out: Path) -> Path:
    return out / DATA / f"{study.name}-{kind}.json"


def reports_of(study: Study, out: Path) -> dict[str, Report]:
    """Reports of a study by device, the GPU's first."""
    found = {}
    for kind in ("cuda", "cpu"):
        path = _data_path(study, kind, out)
        if path.is_file():
            found[kind] = read_report(path)
            if found[kind].get("definition", "") != study.definition:
                raise UsageError(
                    f"{path} was measured with other common settings, or another reference: measure it again, with "
                    "--fresh, or choose another --out"
                )
    if not found:
        raise UsageError(
            f"{out / DATA} has no figures of the study {study.name}: measure it first, or give its rows with --gather"
        )
    return found


def write_page(study: Study, out: Path, plots: bool = True) -> Path:
    """Plots and tables of a study from its figures, whose slopes are judged anew before; returns its page."""
    reports = reports_of(study, out)
    for kind, report in reports.items():
        if judge_anew(report["rows"]):
            write_report(_data_path(study, kind, out), report)
    if plots:
        study.draw(reports, out)
    page = out / f"{study.name}.md"
    title = study.title or study.name.replace("-", " ").capitalize()
    put_fragment(page, study.name, title, study.fragment(reports))
    return page
