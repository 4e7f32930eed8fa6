"""Launches and allocations that fail."""

from __future__ import annotations

import warp as wp

from raybatch_addon.core.device import failures
from raybatch_addon.core.errors import DeviceError, OutOfMemoryError

# Kinds, what is raised for them, and what is said
KINDS = [
    ("launch", DeviceError, "cpu stopped: Warp CUDA error 7.*; try again, or render on another device"),
    ("allocation", OutOfMemoryError, "close other programs|use few"),
]
TRIED = 12  # places of each kind, where it is not thorough


class Faults:
    """Counts launches and allocations, on any thread, and lets one of them fail as Warp does."""

    def __init__(self, monkeypatch):
        self.kind, self.at, self.seen = "", 0, 0
        monkeypatch.setattr(failures, "_is_of_warp", lambda _error: True)  # they are raised here
        context = wp._src.context
        self._watch(
            monkeypatch, wp, "launch", "launch", "Warp CUDA error 700: an illegal memory access was encountered"
        )
        self._watch(monkeypatch, context.Launch, "launch", "launch", "Warp CUDA error 719: unspecified launch failure")
        message = "Failed to allocate 640 bytes on device 'cpu'"
        self._watch(monkeypatch, context.CpuDefaultAllocator, "allocate", "allocation", message)

    def _watch(self, monkeypatch, owner, name, kind, message):
        within = getattr(owner, name)

        def watched(*arguments, **options):
            if kind == self.kind:
                self.seen += 1
                if self.seen == self.at:
                    raise RuntimeError(message)
            return within(*arguments, **options)

        monkeypatch.setattr(owner, name, watched)

    def begin(self, kind, at=0):
        """Count those of `kind` anew: `launch`, `allocation` or none; number `at` fails."""
        self.kind, self.at, self.seen = kind, at, 0

    def places(self, thorough: bool, step: int = 1) -> range:
        """Numbers of those that are to fail one after another: of each `step`th that was counted, or of some."""
        assert self.seen > 50
        return range(1, self.seen + 1, step if thorough else self.seen // TRIED)
