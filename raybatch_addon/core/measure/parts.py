"""How long each part of a render takes: parts follow one another without a gap, so that they add up to the total."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from ..device.notes import is_any_compiled

# Parts of a render in their order, and what a status line says while they go on
PARTS = {
    "export": "Reading the scene",
    "start": "Starting the device",
    "check": "Checking the scene",
    "displacement": "Displacing surfaces",
    "wait": "Waiting for another render",
    "checkpoint": "Reading or writing the checkpoint",
    "images": "Uploading images",
    "tree": "Building the tree",
    "materials": "Uploading materials",
    "lights": "Measuring lights",
    "volumes": "Measuring volumes",
    "kernels": "Loading kernels",
    "paths": "Making room for paths",
    "render": "Rendering",
    "report": "Gathering statistics",
    "denoise": "Denoising",
    "write": "Handing over the picture",
}
_COMPILING = "Compiling kernels"  # what it says where they are not there to be loaded
# Those of a scene on its device; their sum is reported as `build`
BUILD_PARTS = ("images", "tree", "materials", "lights", "volumes")


class Parts:
    """The clock of one render. Threads take turns with it: one part goes on at a time, whoever is at work on it."""

    def __init__(self, first: str, now: Callable[[], float] = time.perf_counter):
        """The part `first` begins. `now` gives the time [s]."""
        self._now, self._lock = now, threading.Lock()
        self.started = self._since = now()
        self.part = first  # that goes on
        self.compile_seconds = 0.0  # of making or loading kernels, which goes on beside other parts
        self._seconds: dict[str, float] = {}

    @property
    def message(self) -> str:
        """What is being done, for a status line."""
        return _COMPILING if self.part == "kernels" and is_any_compiled() else PARTS[self.part]

    @property
    def elapsed(self) -> float:
        """Since the first part began [s]."""
        return self._now() - self.started

    def enter(self, part: str) -> None:
        """The part before ends, and `part`, one of `PARTS`, goes on."""
        with self._lock:
            now = self._now()
            self._seconds[self.part] = self._seconds.get(self.part, 0.0) + now - self._since
            self.part, self._since = part, now

    def record(self) -> dict[str, float]:
        """Seconds until now of each part that there was, `build` of those in `BUILD_PARTS` together, `compile` of what
        went on beside others, and their `total`.
        """
        self.enter(self.part)
        parts = {part: self._seconds[part] for part in PARTS if part in self._seconds}
        sums = {"build": sum(parts.get(part, 0.0) for part in BUILD_PARTS), "compile": self.compile_seconds}
        found = {"render": 0.0, **parts, **sums, "total": sum(parts.values())}
        return {name: round(seconds, 6) for name, seconds in found.items()}
