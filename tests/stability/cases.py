"""The registry: every module of this folder that registers cases, and how a case is run."""

from __future__ import annotations

import importlib
import pkgutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.session import Session
from tests.stability.bench import Bench
from tests.stability.case import CASES, Case, Outcome, Skipped
from tests.support.running.kernel_builds import BUILDS

# families in the order of the report; others follow by name
FAMILIES = ("scale", "geometry", "transforms", "leaks", "lights", "materials", "transport", "numbers", "scheduling")
TRACERS = ("off", "on", "-")  # unbatched, batched; -: where the tracer does not matter


@dataclass(frozen=True)
class Result:
    """One case with one tracer."""

    case: Case
    tracer: str
    outcome: Outcome | None  # None: the case failed with `error`, or was `skipped`
    invalid_samples: int = 0
    samples: int = 0
    seconds: float = 0.0
    compiling: float = 0.0  # seconds of processors that went into kernels, where `build_once` was called
    error: str | None = None
    skipped: str | None = None

    @property
    def passed(self) -> bool:
        """Whether the answer is right, and no sample was invalid; a skipped case neither passed nor failed."""
        return self.outcome is not None and self.outcome.passed and self.invalid_samples == 0

    @property
    def failed(self) -> bool:
        """Whether something is wrong."""
        return not self.passed and self.skipped is None

    @property
    def note(self) -> str:
        """Message about the result."""
        return self.error or self.skipped or (self.outcome.note if self.outcome else "")


class UnknownCase(RayBatchError):
    """A name that no case has."""


def all_cases() -> list[Case]:
    """All cases by family, in the order of registration."""
    package = __name__.rpartition(".")[0]
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.rpartition(".")[2].startswith("test_"):
            importlib.import_module(module.name)
    order = {family: index for index, family in enumerate(FAMILIES)}
    return sorted(CASES.values(), key=lambda each: (order.get(each.family, len(order)), each.family))


def chosen_cases(names: Iterable[str] = (), quick: bool = False) -> list[Case]:
    """The cases that `names` choose: a name, a family, or a part of names; without names all.

    Raises `UnknownCase`.
    """
    cases, names = all_cases(), [name.strip() for name in names if name.strip()]
    chosen: set[str] = set()
    for name in names:
        found = (
            [c.name for c in cases if name == c.name]
            or [c.name for c in cases if name == c.family]
            or [c.name for c in cases if name in c.name]
        )
        if not found:
            families = ", ".join(dict.fromkeys(c.family for c in cases))
            raise UnknownCase(f"no case is called {name!r}: --list names all of them; families are {families}")
        chosen.update(found)
    chosen_here = [c for c in cases if (not names or c.name in chosen) and (c.quick or not quick)]
    if not chosen_here:
        raise UnknownCase(f"of {', '.join(names)} nothing is part of the quick suite: leave out --quick")
    return chosen_here


def run_case(case: Case, bench: Bench) -> Result:
    """Run `case` with the tracer of `bench`; an exception is a failure of the case."""
    bench.invalid_samples = bench.samples = 0
    outcome = error = skipped = None
    start, compiled = time.perf_counter(), BUILDS.seconds
    try:
        outcome = case.run(bench)
    except Skipped as reason:
        skipped = str(reason)
    except Exception as fault:
        error = f"{type(fault).__name__}: {' '.join(str(fault).split())}"
    return Result(
        case,
        bench.tracer,
        outcome,
        bench.invalid_samples,
        bench.samples,
        time.perf_counter() - start,
        BUILDS.seconds - compiled,
        error,
        skipped,
    )


def run_cases(
    cases: Iterable[Case],
    device: str,
    tracers: Iterable[str] = TRACERS,
    cache_folder: str | None = None,
    leak_rays: int = 0,
) -> Iterator[Any]:
    """Yield (case, tracer) before, and the `Result` after, each run of `cases` on `device` (AUTO, cpu or cuda:N).

    `leak_rays` as in `Bench`.
    """
    session, tracers = Session(device, cache_folder=cache_folder), tuple(tracers)
    try:
        benches = {tracer: Bench(device, tracer, session, leak_rays) for tracer in TRACERS}
        for each in cases:
            for tracer in each.tracers:
                if tracer in tracers:
                    yield each, tracer
                    yield run_case(each, benches[tracer])
    finally:
        session.close()
