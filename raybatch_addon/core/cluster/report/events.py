"""What befell a render on a cluster, and was mended: workers that went, films that were damaged. Its report says so."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Literal

# What happened: a worker went (its process ended, or its connection), was silent, or came later than others; a film or
# a part of a scene was not what was sent; a task was lost, failed, or was rendered by two for being late; a machine
# could not keep the scene, or do its part otherwise; the scheduler went
EventKind = Literal[
    "WORKER_GONE",
    "WORKER_SILENT",
    "WORKER_CAME",
    "FILM_DAMAGED",
    "PART_MISSING",
    "TASK_LOST",
    "TASK_LATE",
    "MACHINE_LEFT_OUT",
    "SCHEDULER_LOST",
]
# A report does not grow for ever, whatever happens
EVENTS_MOST = 1000


class ClusterEvents:
    """The events of one render, in their order."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._workers: set[str] | None = None  # addresses, as of the last look; None before the first
        self.all: list[dict[str, Any]] = []  # the first ones: `seconds` since the begin, `kind`, `who` and `text`
        self.left_out = 0  # that came later

    def note(self, kind: EventKind, who: str, text: str) -> None:
        """`who`: the address of a worker or a host, or samples as text."""
        if len(self.all) >= EVENTS_MOST:
            self.left_out += 1
            return
        seconds = round(time.monotonic() - self._begun, 3)
        self.all.append({"seconds": seconds, "kind": kind, "who": who, "text": text})

    def see_workers(self, addresses: Iterable[str], silent: Iterable[str]) -> set[str]:
        """Note who came and went since the last look, and return the latter; `silent` were left out for that."""
        now, silent = set(addresses), set(silent)
        before, self._workers = self._workers, now
        if before is None:
            return set()
        for address in sorted(before - now):
            if address in silent:
                self.note("WORKER_SILENT", address, "nothing was heard of it; its work is done elsewhere")
            else:
                self.note("WORKER_GONE", address, "it ended, or lost its connection; its work is done elsewhere")
        for address in sorted(now - before):
            self.note("WORKER_CAME", address, "it helps from now on")
        return before - now
