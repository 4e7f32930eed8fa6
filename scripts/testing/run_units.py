"""Runs units in processes side by side, until they are done or the time is over."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from testing.outcomes import FILE_VARIABLE, SHARE_VARIABLE, CheckOutcome, read_outcomes
from testing.report import ROOT
from testing.units import Unit

POLL_SECONDS = 0.5
CALLS_PRINTED = 7  # lines
PRINTED_LENGTH = 2000  # characters of what a process printed that are kept
CALL_SECONDS = 10.0  # between calls of `on_change` while nothing ends
# pytest's exit codes without an error: all passed, some failed (each has its line), nothing was left to run
_REPORTED_CODES = (0, 1, 5)
WAITING, RUNNING, DONE, BROKEN, STOPPED = "waiting", "running", "done", "broken", "stopped"


@dataclass
class UnitRun:
    """A unit and its process: waiting, running or ended."""

    unit: Unit
    lines: Path  # its outcomes
    output: Path  # what it printed
    state: str = WAITING
    started: float = 0.0  # seconds of the monotonic clock
    seconds: float = 0.0
    process: subprocess.Popen | None = field(default=None, repr=False)

    @property
    def outcomes(self) -> list[CheckOutcome]:
        """What ended so far."""
        return read_outcomes(self.lines)

    @staticmethod
    def of(units: Sequence[Unit], folder: Path) -> list[UnitRun]:
        """`units`, which will write to files in `folder`."""
        return [
            UnitRun(unit, folder / f"{number}.jsonl", folder / f"{number}.txt") for number, unit in enumerate(units)
        ]

    def begin(self, device: str, kernels: Path) -> None:
        """Start the process."""
        paths = [str(ROOT), str(ROOT / "scripts"), os.environ.get("PYTHONPATH", "")]
        variables = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in paths if path),
            "RAYBATCH_TEST_DEVICE": device,
            "RAYBATCH_KERNEL_CACHE": str(kernels),
            "WARP_CACHE_PATH": str(kernels),
            FILE_VARIABLE: str(self.lines),
            SHARE_VARIABLE: self.unit.share,
        }
        self.state, self.started = RUNNING, time.monotonic()
        with open(self.output, "wb") as output:
            self.process = subprocess.Popen(
                self.unit.command(device),
                cwd=ROOT,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # so that it can be stopped with its own processes
            )

    def poll(self) -> None:
        """Notice the end of the process."""
        assert self.process is not None  # since `begin`
        code = self.process.poll()
        if code is not None:
            self.seconds = time.monotonic() - self.started
            self.state = DONE if code in _REPORTED_CODES else BROKEN

    def stop(self) -> None:
        """End the process, however far it is."""
        assert self.process is not None  # since `begin`
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.state, self.seconds = STOPPED, time.monotonic() - self.started

    def printed(self) -> str:
        """The end of what it printed; where Python died, what it died of and the calls that led there."""
        text = self.output.read_text(encoding="utf-8", errors="replace") if self.output.exists() else ""
        dies, calls = text.find("Fatal Python error"), text.find("Current thread")
        if 0 <= dies < calls:
            return "\n".join([text[dies:].splitlines()[0], *text[calls:].splitlines()[:CALLS_PRINTED]])
        return text[-PRINTED_LENGTH:]


def run_units(
    runs: Sequence[UnitRun], device: str, kernels: Path, jobs: int, end: float, on_change: Callable[[], object]
) -> None:
    """Run all in `jobs` processes until `end` [s of the monotonic clock]; `on_change` is called when one ends, and in
    between.
    """
    called = time.monotonic()
    try:
        while any(run.state in (WAITING, RUNNING) for run in runs) and time.monotonic() < end:
            running = [run for run in runs if run.state == RUNNING]
            for run in running:
                run.poll()
            ended = [run for run in running if run.state != RUNNING]
            free = jobs - len(running) + len(ended)
            for run in [run for run in runs if run.state == WAITING][:free]:
                run.begin(device, kernels)
            if ended or time.monotonic() - called > CALL_SECONDS:
                on_change()
                called = time.monotonic()
            time.sleep(POLL_SECONDS)
    finally:
        for run in runs:
            if run.state == RUNNING:
                run.stop()
        on_change()
