"""Blender's own program, started without a window: what it printed and when, and the code that it ended with."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lib.command import UsageError

# A line of progress, whatever stands before it: its frame, and what is said of it
PROGRESS = re.compile(r"Fra: ?(\d+)\b(.*)")
MARK = "RAYBATCH-STATISTICS "
# Prints the report of the render before it: of whichever way RayBatch is installed
REPORTS = f"""
import json, sys
names = [name for name in sys.modules if name.endswith(".blender.reports")]
last = sys.modules[names[0]].last() if names else None
print("\\n{MARK}" + json.dumps(last and {{"errors": last.errors, "layers": last.statistics}}, default=str), flush=True)
"""
LOOK_SECONDS = 0.02  # how often what is done beside a Blender is done


@dataclass
class EndedBlender:
    """A Blender that has ended."""

    code: int
    seconds: float
    lines: list[tuple[float, str]] = field(default_factory=list)  # seconds since its start, and the line

    @property
    def text(self) -> str:
        """All that it printed."""
        return "\n".join(line for _, line in self.lines)

    @property
    def progress(self) -> list[tuple[float, int, str]]:
        """Its lines of progress: seconds since its start, frame, text."""
        found = [(seconds, PROGRESS.search(line)) for seconds, line in self.lines]
        return [(seconds, int(match[1]), match[2]) for seconds, match in found if match]

    @property
    def statistics(self) -> list[dict[str, Any]]:
        """Statistics of the view layer of each render that was followed by `REPORTS`."""
        reports = [json.loads(line[len(MARK) :]) for _, line in self.lines if line.startswith(MARK)]
        return [layer for report in reports if report for layer in report["layers"].values()]


class BlenderProgram:
    """A Blender that is started again and again."""

    def __init__(self, path: Path, limit: float) -> None:
        """`limit`: seconds after which a call is given up."""
        self.path, self.limit = path, limit

    def run(self, options: Sequence[object], beside: Callable[[BlenderProcess], object] | None = None) -> EndedBlender:
        """Start it without a window, and wait for its end; `beside` is called again and again meanwhile. Raises
        `UsageError` where it cannot be started, or does not end.
        """
        process = self.start(options)
        while not process.is_over():
            if beside is not None:
                beside(process)
            time.sleep(LOOK_SECONDS)
        return process.ended()

    def start(self, options: Sequence[object]) -> BlenderProcess:
        """Start it without a window."""
        return BlenderProcess([str(self.path), "-b", *map(str, options)], self.limit)


class BlenderProcess:
    """A Blender that runs."""

    def __init__(self, command: list[str], limit: float) -> None:
        self._command, self._limit, self._begun = command, limit, time.monotonic()
        self.lines: list[tuple[float, str]] = []
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                start_new_session=True,  # signals reach what it starts too
            )
        except OSError as error:
            raise UsageError(f"{command[0]} cannot be started: {error.strerror}") from None
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None  # a pipe was asked for
        for line in self._process.stdout:
            self.lines.append((time.monotonic() - self._begun, line.rstrip()))

    def is_over(self) -> bool:
        """Whether it has ended; raises `UsageError` where it should have."""
        if self._process.poll() is not None:
            return True
        if time.monotonic() - self._begun > self._limit:
            self.send(signal.SIGKILL)
            raise UsageError(f"Blender did not end within {self._limit:.0f} seconds: {' '.join(self._command)}")
        return False

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def ended(self) -> EndedBlender:
        """What became of it, once it is over."""
        while not self.is_over():
            time.sleep(LOOK_SECONDS)
        seconds = time.monotonic() - self._begun
        self._reader.join()
        return EndedBlender(self._process.returncode, seconds, self.lines)
