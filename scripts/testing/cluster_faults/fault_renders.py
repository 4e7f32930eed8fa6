#!/usr/bin/env python3
"""Render on a cluster whose workers fail at random moments. `fault_renders.py --help` says how."""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any
from unittest import mock

for folder in Path(__file__).resolve().parents[2:4]:  # of the scripts, and of the package
    sys.path.insert(0, str(folder))

import numpy as np
from lib.command import UsageError, run_command
from lib.films import differing_passes
from lib.output import OutputFolders, leave

from testing.report import heading, of_chance, publish

DESCRIPTION = """\
Render on a cluster whose workers are killed, stopped, slowed, cut off, have a full disk or damage a film, at random
moments, and compare the films with those of one process, bit for bit.

The cluster is a scheduler and workers of Dask's own programs on this computer, each with an address and a folder for
scenes of its own, as if on a machine of its own: two for the first half of the renders, and three from then on. Each
render begins with all of them, and with machines that have nothing of the scene; one to four faults befall it. Films
in one go, in halves (error_estimate), and with adaptive sampling take turns. That no sample was lost, and none counted
twice, is seen by the films, by the rays that were traced, and by the list of ranges in the report; which names, too,
the workers that went, machines with a full disk, and damaged films. Runs on the CPU, on Linux. The exit code is 0, or 1
if a film differs, a render does not end, or its report lacks something.
"""
MARKS = ("<!-- faults: made by fault_renders.py -->", "<!-- end of faults -->")
SIZE = (48, 36)  # pixels
BANDS = 2
RENDER_SECONDS = 1.0  # of a processor that a film takes, about, beside what its tasks do
LEAST_SECONDS = 0.5  # of a task, where it can be: its film and its worker's Python take as long
SILENT_SECONDS = 3.0  # a worker is left out that was silent for so long
LIMIT_SECONDS = 600.0  # a render that takes longer hangs
VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "halves": {"error_estimate": "ON"},
    "adaptive": {"adaptive_sampling": "ON", "noise_threshold": 0.05, "adaptive_samples_min": 8},
}


@dataclass
class Outcome:
    """What came of one render."""

    variant: str
    machines: int
    faults: list[dict[str, Any]] = field(default_factory=list)  # those that were done
    events: list[dict[str, Any]] = field(default_factory=list)  # of its report
    tasks_again: int = 0
    seconds: float = 0.0
    faulty: list[str] = field(default_factory=list)  # what should not be


class Variant:
    """The scene with the settings of a variant, and its film by one process."""

    def __init__(self, session: Any, name: str):
        from rendering.standalone import resized

        from tests.support import schedule_scenes

        self.name = name
        self.scene = resized(schedule_scenes.SCENES["mixed"](), *SIZE)
        settings = schedule_scenes.ESTIMATOR.replace(**VARIANTS[name], device="cpu", thread_count=1)
        for count in (32, 128):  # kernels are loaded; then a sample is timed
            started = time.process_time()
            session.render(self.scene, settings.replace(sample_count=count))
        a_sample = (time.process_time() - started) / count
        self.settings = settings.replace(sample_count=max(64, int(RENDER_SECONDS / a_sample)))
        self.expected = session.render(self.scene, self.settings)

    def why_not(self, film: Any) -> list[str]:
        """What of `film` is not as it should be."""
        expected, found = self.expected, []
        if not film.complete:
            return ["it is not complete"]
        pairs = zip((film, *(film.halves or ())), (expected, *(expected.halves or ())), strict=True)
        for mine, theirs in pairs:
            if not np.array_equal(mine.counts, theirs.counts):
                found.append("pixels have other numbers of samples")
            found += [f"the pass {name} differs" for name in differing_passes(mine.passes, theirs.passes)]
        if film.statistics["rays"] != expected.statistics["rays"]:
            found.append("other rays were traced")
        return found + why_not_all(film.statistics["cluster"]["shares"], self.settings.sample_count)


def why_not_all(shares: list[dict[str, Any]], count: int) -> list[str]:
    """What of the samples is missing in the list of ranges, or in it twice."""
    regions: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for each in shares:
        regions.setdefault(tuple(each["region"]), []).append((each["first"], each["end"]))
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in regions) != SIZE[0] * SIZE[1]:
        return ["the bands in the report are not the frame"]
    for ranges in regions.values():
        end = 0
        for first, behind in sorted(ranges):
            if first != end:
                return [f"samples {min(first, end)} to {max(first, end) - 1} of a band are not in the report once"]
            end = behind
        if end != count:
            return [f"the last of {count} samples of a band are not in the report"]
    return []


class FaultyRenders:
    """Renders on one cluster."""

    def __init__(self, machines: Any, variants: list[Variant], random: np.random.Generator):
        self._machines, self._variants, self._random = machines, variants, random
        self.outcomes: list[Outcome] = []

    def render(self, with_faults: bool = True) -> Outcome:
        """One render, of the next variant."""
        from raybatch_addon.core.cluster.connection import Connection
        from raybatch_addon.core.cluster.session import ClusterSession
        from testing.cluster_faults.faults import FaultsOfRender, drawn
        from testing.cluster_faults.said import RenderReport
        from testing.cluster_faults.worker_faults import DAMAGED

        variant = self._variants[len(self.outcomes) % len(self._variants)]
        machines = self._machines.all
        connection = Connection(self._machines.address)
        self._machines.mend(connection)
        faults = drawn(self._random, len(machines)) if with_faults else []
        befalling, outcome = FaultsOfRender(faults, machines), Outcome(variant.name, len(machines))
        started, begun = time.monotonic(), list[float]()

        def on_progress(progress: Any) -> None:
            begun.append(time.monotonic())
            befalling.come_to(progress.fraction)

        session = ClusterSession(connection)
        try:
            befalling.come_to(-1e-9)
            film = session.render(
                variant.scene,
                variant.settings,
                on_progress=on_progress,
                cancelled=lambda: time.monotonic() - started > LIMIT_SECONDS,
            )
            outcome.faulty = variant.why_not(film)
            report = film.statistics["cluster"]
            outcome.events, outcome.tasks_again = report["events"], report["tasks_again"]
        except Exception as error:  # whatever it is, it should not be
            outcome.faulty = [f"{type(error).__name__}: {error}"]
        finally:
            ended = time.monotonic()
            befalling.end()
            session.close()
            connection.close()
        outcome.seconds = round(ended - started, 2)
        report = RenderReport(outcome.events, begun[0] if begun else ended, ended)
        befalling.note_when(ended)
        done = [each for each in faults if each.is_done]
        for fault in done:
            machine = machines[fault.machine]
            others = [each for each in done if each is not fault and each.machine == fault.machine]
            if report.misses(fault, others, machine.host, machine.noted(DAMAGED)):
                outcome.faulty.append(
                    f"the report does not say that a machine was befallen: {fault.kind}, {machine.host}"
                )
            after = round((fault.done_at or started) - started, 2)
            kept = asdict(fault) | {"after": after, "said": report.has(fault, machine.host)}
            outcome.faults.append({name: kept[name] for name in ("kind", "machine", "after", "seconds", "said")})
        self.outcomes.append(outcome)
        return outcome


def run(options: argparse.Namespace, folders: OutputFolders, standard_output: IO[str]) -> int:
    """The exit code; raises `RayBatchError`."""
    if not sys.platform.startswith("linux"):
        raise UsageError("stand-ins for machines need Linux: addresses 127.0.0.2 and on, and limits of other processes")
    try:
        import distributed
    except ImportError as error:
        raise UsageError(f"Dask is not installed ({error}); `make environment` installs it") from None
    del distributed
    from raybatch_addon.blender.kernel_cache import kernel_cache_folder
    from raybatch_addon.core.cluster import bands, connection, ranges
    from raybatch_addon.core.session import Session
    from testing.cluster_faults.machines import Machines

    for name in (options.json, options.page):
        if name and str(name) != "-":
            folders.prepare(Path(name).absolute())
    start, session = time.perf_counter(), Session("cpu", cache_folder=kernel_cache_folder())
    variants = [Variant(session, name) for name in options.variants]
    with (
        # tasks have half of a worker's part of what is left, however busy the machine is: some fifteen in a render
        mock.patch.multiple(
            ranges, TASK_SECONDS=1e6, LAYER_SECONDS=1e6, TASK_TIMES_FILM=0.0, LEAST_SECONDS=LEAST_SECONDS
        ),
        mock.patch.object(bands, "BAND_PIXELS", SIZE[0] * SIZE[1] // BANDS),
        mock.patch.object(connection, "SILENT_SECONDS", SILENT_SECONDS),
        tempfile.TemporaryDirectory(prefix="raybatch-faults-", ignore_cleanup_errors=True) as scratch,
    ):
        machines = Machines(Path(scratch))
        try:
            for _ in range(2):
                machines.add()
            renders = FaultyRenders(machines, variants, np.random.default_rng(options.seed))
            alone = [renders.render(with_faults=False) for _ in variants]  # workers load their kernels
            renders.outcomes.clear()
            for number in range(options.renders):
                if options.seconds and time.perf_counter() - start > options.seconds:
                    break
                if number == (options.renders + 1) // 2:
                    machines.add()
                outcome = renders.render()
                what = ", ".join(each["kind"] for each in outcome.faults) or "nothing"
                print(
                    f"fault_renders.py: {number + 1} of {options.renders}: {outcome.variant}, {what}: "
                    f"{outcome.seconds} s{''.join(f'; {each}' for each in outcome.faulty)}",
                    file=sys.stderr,
                    flush=True,
                )
        finally:
            machines.close()
            session.close()
    report = of_chance(
        options,
        start,
        samples=[each.settings.sample_count for each in variants],
        outcomes=[asdict(each) for each in (*alone, *renders.outcomes)],
    )
    publish(options, report, table_of(report), MARKS, standard_output)
    return int(any(each["faulty"] for each in report["outcomes"]))


def table_of(report: dict[str, Any]) -> str:
    """The report as tables of Markdown."""
    from testing.cluster_faults.faults import KINDS

    outcomes = report["outcomes"][len(report["samples"]) :]  # before them nothing befell a worker
    faults = [fault for each in outcomes for fault in each["faults"]]
    rows = ["| what befell a worker | times | in renders | the report says so |", "|---|---:|---:|---:|"]
    for kind, (_, text) in KINDS.items():
        own = [each for each in faults if each["kind"] == kind]
        renders = sum(any(fault["kind"] == kind for fault in each["faults"]) for each in outcomes)
        rows.append(f"| {kind}: {text} | {len(own)} | {renders} | {sum(each['said'] for each in own)} |")
    rows.append(f"| all | {len(faults)} | {len(outcomes)} | {sum(each['said'] for each in faults)} |")
    rows += ["", "| machines | film | renders | faults | tasks rendered again | films that differ |"]
    rows.append("|---:|---|---:|---:|---:|---:|")
    for machines, variant in sorted({(each["machines"], each["variant"]) for each in outcomes}):
        rows.append(_row([each for each in outcomes if (each["machines"], each["variant"]) == (machines, variant)]))
    rows.append(_row(outcomes, "all"))
    wrong = [
        f"- {each['machines']} machines, {each['variant']}, {', '.join(fault['kind'] for fault in each['faults'])}: "
        f"{text}"
        for each in report["outcomes"]
        for text in each["faulty"]
    ]
    return "\n".join([heading(report), "", *rows, *(["", *wrong] if wrong else [])])


def _row(outcomes: list[dict[str, Any]], name: str = "") -> str:
    """The row of these renders, which have the same machines and variant where there is no `name`."""
    head = f"{name} |" if name else f"{outcomes[0]['machines']} | {outcomes[0]['variant']}"
    numbers = (
        len(outcomes),
        sum(len(each["faults"]) for each in outcomes),
        sum(each["tasks_again"] for each in outcomes),
        sum(bool(each["faulty"]) for each in outcomes),
    )
    return f"| {head} | {' | '.join(map(str, numbers))} |"


def main(arguments: list[str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(
        prog="fault_renders.py", description=DESCRIPTION, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--renders", type=int, default=50, metavar="N", help="default: 50")
    parser.add_argument("--seconds", type=float, metavar="S", help="begin no render after so long")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of chance; default: 0")
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON too; - is standard output")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the tables between their marks in a page")
    options = parser.parse_args(arguments)
    return run_command("fault_renders.py", False, functools.partial(run, options))


if __name__ == "__main__":
    leave(main())
