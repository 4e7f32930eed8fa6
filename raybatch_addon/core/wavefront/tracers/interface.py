"""The interface that the integrator asks of a tracer, and the tracer that does not batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from ...bvh.traverse.counts import TraceCounts
from ...measure.timing import NoTimer, StageTimer
from ...rays import RayKind, RayList, Rays
from ..order.ray_order import RayOrder

if TYPE_CHECKING:
    from ...bvh.traverse.reference import ReferenceTree
    from ...bvh.tree import Tree
    from .unbatched import TraceStage


class Tracer(Protocol):
    """Resumable ray queries: rays of many bounces, of both kinds, may be under way at once."""

    def submit(self, kind: RayKind, rays: RayList) -> None:
        """Take rays in. Their slots are the tracer's until they come back; the list itself is overwritten after
        `advance`, so a tracer that lets rays wait keeps a copy of it."""

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """Work on rays that are under way; at least one of them finishes. Where `stop` says that the render is to end,
        it is left at that as soon as some work is done, and perhaps none has finished."""

    def take_finished(self) -> list[tuple[RayKind, RayList]]:
        """Rays that are done since the last call, their hits written to their slots."""

    def forget(self) -> None:
        """The rays that are under way do not come back, nor do those that are done; their slots are no more the
        tracer's.
        """

    def release(self) -> None:
        """Give up what was captured for the device. Called between rays, on the thread that made the tracer."""


class UnbatchedTracer:
    """A `Tracer` in which every ray visits the whole tree as soon as it is asked to advance."""

    def __init__(
        self,
        tree: Tree | ReferenceTree,
        rays: Rays,
        stages: dict[RayKind, TraceStage],
        *,
        order: RayOrder | None = None,
        timer: StageTimer | NoTimer | None = None,
        counts: Sequence[TraceCounts] | None = None,
    ):
        """`stages` trace lists of rays by kind (`wavefront/tracers/unbatched.py`) in `tree`; `order` may sort the rays
        before, and what they do is added to `counts`, by kind.
        """
        self._tree = tree
        self._rays = rays
        self._stages = stages
        self._order = order
        self._timer = timer or NoTimer()
        self._counts = counts
        self._under_way: list[tuple[RayKind, RayList]] = []
        self._finished: list[tuple[RayKind, RayList]] = []

    def submit(self, kind: RayKind, rays: RayList) -> None:
        self._under_way.append((kind, rays))

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        for kind, rays in self._under_way:
            counts = self._counts[kind] if self._counts else None
            for part in self._order.parts(kind, rays, self._rays) if self._order else (rays,):
                with self._timer.stage("trace"):
                    self._stages[kind].launch(self._tree, self._rays, part, counts)
        self._finished += self._under_way
        self._under_way = []

    def take_finished(self) -> list[tuple[RayKind, RayList]]:
        finished, self._finished = self._finished, []
        return finished

    def forget(self) -> None:
        self._under_way, self._finished = [], []

    def release(self) -> None:
        pass
