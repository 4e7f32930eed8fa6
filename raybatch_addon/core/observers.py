"""Reports of a render while it runs, and who receives them."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from .measure.snapshot import Snapshot

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a render has come."""

    stage: str  # "build", "compile" or "render"
    fraction: float  # of the stage, 0..1
    samples_done: float  # mean samples per pixel
    samples_total: int
    rays_per_second: float
    seconds_elapsed: float
    seconds_left: float | None  # None: not known yet
    memory_bytes: int  # held now: on the device, on a CPU by this process; 0: unknown
    memory_peak: int  # the most that was held so far
    message: str
    kernels: str = ""  # that render: "general" or "specialised"; empty before the first ray
    compiles: bool = False  # specialised kernels are compiled beside, to take over or for the next render
    seconds_rendering: float = 0.0  # part of `seconds_elapsed` in which rays are traced; `rays_per_second` refers to it


class Cancel(enum.Enum):
    """How a render is ended before its end, for those to whom True is not enough."""

    AT_ONCE = enum.auto()  # paths under way are given up: no render goes on from such a film


@dataclass(frozen=True)
class Tile:
    """A finished part of the picture."""

    x: int  # of the bottom left pixel in the frame
    y: int
    width: int
    height: int
    passes: dict[str, np.ndarray]  # linear float32, shape [height, width, channels], bottom row first


class RenderObserver(Protocol):
    """Whoever watches a render. Observers derive from this class and define the methods that they need; all are called
    on the thread that called `Session.render`.
    """

    # Defaults have a `return`: mypy takes a method of a protocol that has none for one that must be defined

    def on_tile(self, tile: Tile) -> None:
        """Receive a finished tile."""
        return

    def on_progress(self, progress: Progress) -> None:
        """Receive how far the render has come, several times a second."""
        return

    def snapshot_samples(self, sample_count: int) -> Sequence[int] | None:
        """Return the sample counts, of a render of `sample_count` samples, at which snapshots are wanted beside the one
        at the end. None: no snapshots at all, not even at the end.
        """
        return None

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Receive the picture at one of the wanted sample counts, or at the end."""
        return


def call_all(own: Callable[[T], None] | None, others: Sequence[Callable[[T], None]]) -> Callable[[T], None]:
    """A function that calls `own`, where there is one, and then `others`."""
    calls = [*([own] if own else []), *others]

    def call(value: T) -> None:
        for each in calls:
            each(value)

    return call
