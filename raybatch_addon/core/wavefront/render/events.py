"""What a render calls while it goes on: who sees tiles, progress and pictures, cancels it, or keeps how far it came."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...film.tile import FinishedTile
from ...measure.snapshot import Snapshot
from ...observers import Cancel, RenderObserver
from .resume import ResumeState
from .rounds import sample_marks


class StateKeeper(Protocol):
    """Whoever keeps how far a render has come, while it goes on."""

    def start(self) -> None:
        """The workers are about to begin."""

    def is_due(self) -> bool:
        """Whether the workers are to stop for it now; asked several times a second."""

    def keep(self, state: ResumeState) -> None:
        """Copy `state` and its sums: no worker is at them until this returns."""


@dataclass(frozen=True)
class SnapshotWatcher:
    """An observer who receives pictures on the way."""

    marks: tuple[int, ...]  # sample counts of the pictures, ascending; one more comes at the end
    on_snapshot: Callable[[Snapshot], None]


def snapshot_watchers(observers: Iterable[RenderObserver], sample_count: int) -> list[SnapshotWatcher]:
    """The observers that want snapshots of a render of `sample_count` samples."""
    wanted = [(observer, observer.snapshot_samples(sample_count)) for observer in observers]
    return [
        SnapshotWatcher(sample_marks(marks, sample_count), observer.on_snapshot)
        for observer, marks in wanted
        if marks is not None
    ]


@dataclass(frozen=True, kw_only=True)
class RenderEvents:
    """Functions to call when something happens. All calls come from the thread that calls `Rendering.run`."""

    on_tile: Callable[[FinishedTile, dict[str, np.ndarray]], None]  # with the passes of its rectangle
    # arguments: share of the work that is done, mean samples of a pixel, seconds of rendering
    on_progress: Callable[[float, float, float], None]
    cancelled: Callable[[], bool | Cancel]
    watchers: Sequence[SnapshotWatcher]
    keeper: StateKeeper | None = None
