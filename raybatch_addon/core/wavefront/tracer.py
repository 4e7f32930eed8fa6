"""What the integrator asks of a tracer, and the tracer that does not batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import warp as wp

from .rays import RayKind, Rays


@dataclass(frozen=True)
class SlotList:
    """Ray slots on the device; the length is known exactly there and bounded on the host."""

    slots: wp.array  # int32, shape [>= bound]
    count: wp.array  # int32, shape [1]
    bound: int  # at least `count[0]`
    coherent: bool = False  # camera rays: neighbours in the list visit the same nodes


NO_SLOTS = SlotList(None, None, 0)  # stands for an empty list


class Tracer(Protocol):
    """Resumable ray queries: rays of many bounces, of both kinds, may be under way at once."""

    def submit(self, kind: RayKind, rays: SlotList) -> None:
        """Take rays in. Their slots are the tracer's until they come back; the list itself is overwritten after `advance`, so a
        tracer that lets rays wait keeps a copy of it."""

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """Work on rays that are under way; at least one of them finishes. Where `stop` tells that the render is to end, it is left at
        that as soon as some work is done, and perhaps none has finished."""

    def take_finished(self) -> list[tuple[RayKind, SlotList]]:
        """Rays that are done since the last call, their hits written to their slots."""

    def forget(self) -> None:
        """The rays that are under way do not come back, nor do those that are done; their slots are no more the tracer's."""


class UnbatchedTracer:
    """A `Tracer` in which every ray visits the whole tree as soon as it is told to advance."""

    def __init__(self, tree: Any, rays: Rays, stages: dict[RayKind, Any], trace: Callable | None = None):
        """`stages` trace lists of rays by kind (`stages/trace.py`) in `tree`.

        `trace(kind, rays, launch)`, where there is one, calls `launch(rays, counts)` for lists that hold the same rays: it may sort
        them, count, or take times.
        """
        self._tree = tree
        self._rays = rays
        self._stages = stages
        self._trace = trace or (lambda kind, rays, launch: launch(rays, None))
        self._under_way: list[tuple[RayKind, SlotList]] = []
        self._finished: list[tuple[RayKind, SlotList]] = []

    def submit(self, kind: RayKind, rays: SlotList) -> None:
        self._under_way.append((kind, rays))

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        for kind, rays in self._under_way:
            stage = self._stages[kind]
            self._trace(kind, rays, lambda listed, counts: stage.launch(self._tree, self._rays, listed, counts))
        self._finished += self._under_way
        self._under_way = []

    def take_finished(self) -> list[tuple[RayKind, SlotList]]:
        finished, self._finished = self._finished, []
        return finished

    def forget(self) -> None:
        self._under_way, self._finished = [], []
