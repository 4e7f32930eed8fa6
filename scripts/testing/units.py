"""The work that is run on a GPU, cut into units for processes, and the units into parts for calls.

A unit is a share of a long file of tests, a few short files, or a few cases of tests/stability from one module, which
share kernels. Units and parts depend on the sources and on the stored seconds alone: every machine cuts them alike.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lib.output import write_text

from testing.report import ROOT
from tests.stability.case import Case
from tests.stability.cases import all_cases
from tests.support.running.file_seconds import file_seconds

STORED = Path(__file__).with_name("gpu_seconds.json")
# Rooms whose tests run without Blender; those of tests/stability are replaced by the cases themselves
FOLDERS = ("tests/core", "tests/renders")
UNIT_SECONDS = 20.0  # about what a unit takes, in one process
CASE_SECONDS = 4.0  # of a case with all its tracers that was never timed
TRACER_SECONDS = 100.0  # of a case from which on each of its tracers is a unit


@dataclass(frozen=True)
class Unit:
    """Work of one process."""

    name: str
    seconds: float  # expected
    files: tuple[str, ...] = ()  # of tests
    share: str = "1/1"  # of their tests
    cases: tuple[str, ...] = ()
    tracer: str = ""  # of cases; empty: each

    def command(self, device: str) -> list[str]:
        """The process."""
        if self.cases:
            tracer = [f"--tracer={self.tracer}"] if self.tracer else []
            return [sys.executable, str(Path(__file__).with_name("run_cases.py")), *tracer, device, *self.cases]
        options = ["-p", "testing.outcomes", "-p", "no:cacheprovider"]
        return [sys.executable, "-m", "pytest", *options, *self.files]


def stored_seconds() -> dict[str, float]:
    """Seconds on a GPU, by file of tests and by name of a case."""
    return json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}


def store_seconds(seconds: dict[str, float]) -> None:
    """Write `seconds` over those that are stored."""
    merged = stored_seconds() | seconds
    lines = [f"{json.dumps(name)}: {round(merged[name], 1)}" for name in sorted(merged)]
    write_text(STORED, "{\n" + ",\n".join(lines) + "\n}\n")


def all_units() -> list[Unit]:
    """Everything, the longest first."""
    stored = stored_seconds()
    files = sorted(path.relative_to(ROOT).as_posix() for f in FOLDERS for path in (ROOT / f).rglob("test_*.py"))
    units = _file_units({file: stored.get(file, file_seconds(file)) for file in files})
    modules: dict[str, list[Case]] = {}
    for each in all_cases():
        modules.setdefault(each.run.__module__, []).append(each)
    for name, cases in modules.items():
        units += _case_units(name.removeprefix("tests.stability."), cases, stored)
    return sorted(units, key=lambda unit: (-unit.seconds, unit.name))


def _file_units(seconds: dict[str, float]) -> list[Unit]:
    units = []
    for file in (each for each in seconds if seconds[each] > UNIT_SECONDS):
        count = math.ceil(seconds[file] / UNIT_SECONDS)
        for i in range(1, count + 1):
            units.append(Unit(f"{file} {i}/{count}", seconds[file] / count, (file,), f"{i}/{count}"))
    for files, taken in _groups({file: each for file, each in seconds.items() if each <= UNIT_SECONDS}):
        more = f" and {len(files) - 1} more" if len(files) > 1 else ""
        units.append(Unit(files[0] + more, taken, tuple(files)))
    return units


def _case_units(module: str, cases: Sequence[Case], stored: dict[str, float]) -> list[Unit]:
    seconds = {each.name: stored.get(each.name, CASE_SECONDS) for each in cases}
    long = [each for each in cases if seconds[each.name] >= TRACER_SECONDS and each.traces]
    groups = _groups({each.name: seconds[each.name] for each in cases if each not in long})
    units = [
        Unit(f"cases of {module} {number}/{len(groups)}", taken, cases=tuple(names))
        for number, (names, taken) in enumerate(groups, 1)
    ]
    for each in long:  # batched it may take most of the time
        share = seconds[each.name] / len(each.tracers)
        units += [Unit(f"{each.name} ({tracer})", share, cases=(each.name,), tracer=tracer) for tracer in each.tracers]
    return units


def _groups(seconds: dict[str, float]) -> list[tuple[list[str], float]]:
    """Neighbours together as long as they take no longer than a unit should; names and sums of seconds."""
    groups: list[tuple[list[str], float]] = []
    for name, each in seconds.items():
        if groups and groups[-1][1] + each <= UNIT_SECONDS:
            groups[-1] = (groups[-1][0] + [name], groups[-1][1] + each)
        else:
            groups.append(([name], each))
    return groups


def part_of(units: Sequence[Unit], number: int, count: int) -> list[Unit]:
    """Part `number` of 1 to `count`: each unit, the longest first, joins the part that has least to do."""
    loads = [0.0] * count
    mine = []
    for unit in units:
        least = loads.index(min(loads))
        loads[least] += unit.seconds
        if least == number - 1:
            mine.append(unit)
    return mine
