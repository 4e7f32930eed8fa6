"""A command line that renders, as a process: how far it is, what it wrote, and why it failed, as its lines say."""

from __future__ import annotations

import collections
import re
import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

# What render.py writes to standard error: progress, files, and how it ended
_PROGRESS = re.compile(r"(?:frame (-?\d+): )?([\d.]+)/(\d+) samples(.*)")
_SAVED = re.compile(r"render\.py: saved (.+)")
_ERROR = re.compile(r"render\.py: error: (.+)")
_NOTE = re.compile(r"(?:frame (-?\d+): |render\.py: )?(.+)")
_LINES_KEPT = 20
# A process that was asked to stop, and does not within so long, is ended [s]
STOP_SECONDS = 30.0
_STOPPED = 130  # exit code of render.py


class RenderProcess:
    """A process that renders frames. Properties are read on any thread."""

    def __init__(self, command: Sequence[str], variables: dict[str, str], frames: Sequence[int] = ()):
        """Begin it; `frames`: those of an animation. Raises `OSError`."""
        self.frames = [*frames]
        self.message = "Starting"
        self.warnings: list[str] = []
        self.saved: list[Path] = []
        self.is_stopped = False  # it was asked to stop
        self._frame_share = 0.0
        self._error = ""
        self._last: collections.deque[str] = collections.deque(maxlen=_LINES_KEPT)
        self._process = subprocess.Popen(
            [*command],
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        self._reader = threading.Thread(target=self._read, name="RayBatch cluster render", daemon=True)
        self._reader.start()

    @property
    def is_running(self) -> bool:
        """Whether it goes on, or has lines that were not read."""
        return self._reader.is_alive() or self._process.poll() is None

    @property
    def fraction(self) -> float:
        """How much is done, 0 to 1."""
        return min((len(self.saved) + self._frame_share) / max(len(self.frames), 1), 1.0)

    @property
    def error(self) -> str:
        """Why it failed, once it is over; empty where it did not, or was stopped."""
        code = self._process.poll()
        if code == 0 or code is None or self.is_stopped or code == _STOPPED:
            return ""
        return self._error or f"the process ended with code {code}: {' '.join([*self._last][-1:]) or 'it said nothing'}"

    def stop(self) -> None:
        """Ask it to end: frames that are finished stay."""
        self.is_stopped = True
        if self._process.poll() is None:
            self._process.terminate()
            threading.Thread(target=self._end, daemon=True).start()

    def kill(self) -> None:
        """End it now, and wait."""
        self.is_stopped = True
        self._process.kill()
        self._process.wait()

    def _end(self) -> None:
        try:
            self._process.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def _read(self) -> None:
        assert self._process.stderr is not None  # as it was begun
        for line in self._process.stderr:
            if text := line.strip():
                self._hear(text)
        self._process.wait()

    def _hear(self, line: str) -> None:
        """Take what a line says."""
        self._last.append(line)
        if found := _SAVED.fullmatch(line):
            self.saved.append(Path(found[1]))
            self._frame_share = 0.0
        elif found := _ERROR.fullmatch(line):
            self._error = found[1]
        elif line.startswith("render.py: warning: "):
            self.warnings.append(line.removeprefix("render.py: warning: "))
        elif found := _PROGRESS.fullmatch(line):
            number, done, total, rest = found.groups()
            self._frame_share = min(float(done) / max(int(total), 1), 1.0)
            self.message = f"{self._place(number)}{done} of {total} samples{rest}"
        elif found := _NOTE.fullmatch(line):
            self.message = self._place(found[1]) + found[2]

    def _place(self, number: str | None) -> str:
        if number is None or int(number) not in self.frames:
            return ""
        return f"Frame {number}, {self.frames.index(int(number)) + 1} of {len(self.frames)}: "
