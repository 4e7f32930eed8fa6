"""What a case of the suite is: a scene or a calculation with a known answer, a bound on the error, and what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bench import Bench


@dataclass(frozen=True)
class Outcome:
    """What a case measured; of a sweep the worst value."""

    measured: float
    expected: float
    tolerance: float  # absolute
    note: str = ""  # such as where in a sweep the worst was found

    @property
    def passed(self) -> bool:
        """Whether the answer is right; never for NaN, nor for a tolerance that allows everything."""
        return self.measured == self.expected or abs(self.measured - self.expected) <= self.tolerance < math.inf


@dataclass(frozen=True)
class Case:
    """One entry of the registry."""

    name: str
    family: str
    about: str  # what is done, and where the expected value comes from
    bound: str  # why the tolerance
    run: Callable[[Bench], Outcome]
    traces: bool  # run for both tracers; else once
    quick: bool  # part of the quick suite

    @property
    def tracers(self) -> tuple[str, ...]:
        """The tracers that the case runs for: `off`, `on`; `-` where none matters."""
        return ("off", "on") if self.traces else ("-",)


class Skipped(Exception):
    """Raised by a case that cannot run here; the text says what it needs."""


CASES: dict[str, Case] = {}


def case(name: str, family: str, about: str, bound: str, traces: bool = True, quick: bool = False) -> Callable[[Callable[[Bench], Outcome]], Callable]:
    """Register the decorated function, which takes a `Bench` and returns an `Outcome`; raises `ValueError` for a name that is taken."""

    def register(run: Callable[[Bench], Outcome]) -> Callable[[Bench], Outcome]:
        if name in CASES:
            raise ValueError(f"two cases are called {name!r}: give each a name of its own")
        CASES[name] = Case(name, family, " ".join(about.split()), " ".join(bound.split()), run, traces, quick)
        return run

    return register


@dataclass
class Sweep:
    """The worst value of a swept parameter, in units of its tolerance: `add` each, then return `outcome()`."""

    worst: Outcome | None = None
    count: int = 0

    def add(self, measured: float, expected: float, tolerance: float, note: str = "") -> None:
        """One value of the sweep; the tolerance is absolute."""
        self.count += 1
        added = Outcome(float(measured), float(expected), float(tolerance), note)
        if self.worst is None or _excess(added) > _excess(self.worst):
            self.worst = added

    def outcome(self) -> Outcome:
        """The value that came nearest to its tolerance, or exceeds it most."""
        if self.worst is None:
            raise ValueError("a sweep without values")
        return self.worst


def _excess(outcome: Outcome) -> float:
    """The error in units of the tolerance; infinite where one of the numbers is none: nothing is worse."""
    if outcome.measured == outcome.expected:
        return 0.0
    error = abs(outcome.measured - outcome.expected)
    excess = error / outcome.tolerance if 0 < outcome.tolerance < math.inf else math.inf
    return math.inf if math.isnan(excess) else excess
