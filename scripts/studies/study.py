"""The parts of a study: measurements in a fixed order, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.bench import Bench

Row = dict[str, Any]
Report = dict[str, Any]  # of one device: see `rows.gathered`


@dataclass(frozen=True)
class Options:
    """The options given on the command line."""

    device: str = "AUTO"
    quick: bool = False
    turns: int = 0  # 0: the study's own number
    scenes: tuple[Path, ...] = ()  # folders in which scenes are looked for
    cache: Path = Path()  # for what may be made again: references, .blend files
    is_cuda: bool = False

    def pick(self, quick: Any, full: Any) -> Any:
        """`quick` of a quick study, else `full`."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Case:
    """One thing that is measured, once in every turn. Cases of a `group` take turns, and are never split over parts."""

    key: str  # unique in its study
    group: str
    what: dict[str, Any] = field(default_factory=dict)  # JSON values that are written to each of its rows


@dataclass(frozen=True)
class Study:
    """A registry's entry; each is a small module."""

    name: str
    about: str
    cases: Callable[[Options], list[Case]]
    measure: Callable[[Case, int, Bench], Row]  # one turn of a case
    fragment: Callable[[dict[str, Report]], str]  # markdown of the reports by device
    draw: Callable[[dict[str, Report], Path], None]  # plots into a folder, as NAME-*.svg
    _: KW_ONLY
    turns: tuple[int, int] = (2, 3)  # quick, full
    title: str = ""  # of the page; empty: made of the name
    # digest of what is measured, of a study that a user defines: rows of another one do not go with it
    definition: str = ""


def groups_of(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Cases by group, in order."""
    found: dict[str, list[Case]] = {}
    for case in cases:
        found.setdefault(case.group, []).append(case)
    return found


def part_of(cases: Sequence[Case], part: int, parts: int) -> list[Case]:
    """Part `part` (from 1) of `parts`: whole groups, about as many cases in each."""
    groups = groups_of(cases)
    loads = [0] * parts
    chosen: list[Case] = []
    for name in sorted(groups, key=lambda each: -len(groups[each])):
        least = loads.index(min(loads))
        loads[least] += len(groups[name])
        if least == part - 1:
            chosen += groups[name]
    return [case for case in cases if case in chosen]
