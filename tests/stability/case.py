"""Cases of the suite: a scene or a calculation with a known answer, and a bound on the error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.stability.bench import Bench


@dataclass(frozen=True)
class Outcome:
    """Measured and expected value of a case; for a sweep its worst value."""

    measured: float
    expected: float
    tolerance: float  # absolute
    note: str = ""  # for example the parameters of a sweep's worst value

    @property
    def passed(self) -> bool:
        """Whether the answer is right; never for NaN, nor for a tolerance that allows everything."""
        return self.measured == self.expected or abs(self.measured - self.expected) <= self.tolerance < math.inf


@dataclass(frozen=True)
class Case:
    """One entry of the registry."""

    name: str
    family: str
    about: str  # what is done, and the source of the expected value
    bound: str  # why the tolerance is what it is
    run: Callable[[Bench], Outcome]
    traces: bool  # the case runs for both tracers; else once
    quick: bool  # part of the quick suite

    @property
    def tracers(self) -> tuple[str, ...]:
        """The tracers that the case runs for: `off`, `on`; `-` if the tracer does not matter."""
        return ("off", "on") if self.traces else ("-",)


class Skipped(Exception):
    """Raised by a case that cannot run here; the text says what it needs."""


CASES: dict[str, Case] = {}


def case(
    name: str, family: str, about: str, bound: str, traces: bool = True, quick: bool = False
) -> Callable[[Callable[[Bench], Outcome]], Callable]:
    """Register the decorated function, which takes a `Bench` and returns an `Outcome`.

    Raises `ValueError` for a name that another case has.
    """

    def register(run: Callable[[Bench], Outcome]) -> Callable[[Bench], Outcome]:
        if name in CASES:
            raise ValueError(f"two cases are called {name!r}: give each a name of its own")
        CASES[name] = Case(name, family, " ".join(about.split()), " ".join(bound.split()), run, traces, quick)
        return run

    return register


@dataclass
class Sweep:
    """The worst value of a swept parameter, in units of its tolerance: `add` each value, then return `outcome()`."""

    worst: Outcome | None = None
    count: int = 0

    def add(self, measured: float, expected: float, tolerance: float, note: str = "") -> None:
        """Add a value; the tolerance is absolute."""
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
    """The error in units of the tolerance; infinite, and so the worst, if one of the numbers is NaN."""
    if outcome.measured == outcome.expected:
        return 0.0
    error = abs(outcome.measured - outcome.expected)
    excess = error / outcome.tolerance if 0 < outcome.tolerance < math.inf else math.inf
    return math.inf if math.isnan(excess) else excess
