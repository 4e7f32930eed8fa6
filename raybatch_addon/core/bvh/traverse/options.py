"""Options that traversals of the own trees are compiled for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

from .task import VisitTask


class TopLevelTraversal(Enum):
    """How the rays of a warp go through what is above the treelets: the setting `top_level_traversal`.

    Thesis, sections 3.3.2 and 6.1 (there TOPLEVEL); what it leaves open, and how that was chosen, is said in
    `cuda_visit.py`. The layout BOXES has no warps: there all but INTERLOCKED are NAIVE.
    """

    NAIVE = "naive"
    """Each ray for itself; lanes that are idle take new rays when there are enough of them."""
    INTERLOCKED = "interlocked"
    """Each ray for itself; new rays are taken only when all that are carried have stopped."""
    SHORT_SEGMENT = "short segment"
    """All rays visit the same nodes, or wait, until some enter a treelet. Then these wait to enter it, all others wait
    behind it, and new rays are taken.
    """
    LONG_HAUL = "long haul"
    """All rays visit the same nodes, or wait; those that enter a treelet are replaced at once by new ones."""

    @property
    def elects(self) -> bool:
        """Whether the rays of a warp visit the same nodes."""
        return self in (TopLevelTraversal.SHORT_SEGMENT, TopLevelTraversal.LONG_HAUL)

    @property
    def takes_together(self) -> bool:
        """Whether new rays are taken only when all that are carried have stopped."""
        return self in (TopLevelTraversal.INTERLOCKED, TopLevelTraversal.SHORT_SEGMENT)


INTERLEAVE = 16
"""Rays that one thread carries at a time, where the layout is BOXES."""


@dataclass(frozen=True, kw_only=True)
class TraversalOptions:
    """Options that the traversals of whole trees and of cut ones have in common. None of them changes a hit."""

    instancing: bool  # a top level over many entries, instead of one entry in world space that every ray sees
    motion: bool = False  # instances and vertices move while rays are on their way; with instancing
    counters: bool = False  # count steps (`TraceCounts`)
    curves: bool = False  # some primitives are segments of curves (`scene/segments.py`), which other kernels never meet
    interleave: int = INTERLEAVE  # BOXES: rays that a thread carries at a time, 1..64
    # QUANTISED: lanes that must wait before a warp takes new rays, 1..32; 0: one ray a thread, of whole trees alone
    refill: int = 8
    # QUANTISED: the first of a single warp's lanes alone takes rays (`refill` is not 0)
    single_lane: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.refill <= 32:
            raise ValueError("refill is 0..32")
        if self.single_lane and not self.refill:
            raise ValueError("a single lane takes rays from the list: refill must not be 0")

    def one_at_a_time(self) -> Self:
        """One ray at a time in the whole device, for debugging."""
        return replace(self, interleave=1, refill=32, single_lane=True)


@dataclass(frozen=True, kw_only=True)
class TraceOptions(TraversalOptions):
    """Options that the traversal of whole trees is compiled for."""

    any_hit: bool  # whether anything before `t_max` is asked for, instead of the closest hit
    leaf_groups: int = 2  # QUANTISED: groups of triangles that may wait while nodes are visited, 1 or 2
    every_triangle: bool = False  # QUANTISED: test all waiting triangles in each turn, instead of one

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.leaf_groups not in (1, 2):
            raise ValueError("leaf_groups is 1 or 2")


@dataclass(frozen=True, kw_only=True)
class VisitOptions(TraversalOptions):
    """Options that a task on cut trees is compiled for."""

    task: VisitTask
    top_level: TopLevelTraversal = TopLevelTraversal.NAIVE  # of TOP alone
    lanes: int = 1  # QUANTISED, TOP, on a CPU: lanes that take turns as those of a CUDA warp do, 1..32
    tiers: bool = False  # in TOP, there are large treelets

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.refill:
            raise ValueError("refill is 1..32")
        if not 1 <= self.lanes <= 32:
            raise ValueError("lanes is 1..32")

    def without_warps(self) -> VisitOptions:
        """The same for the layout BOXES, where no lanes vote."""
        return replace(self, top_level=TopLevelTraversal.NAIVE, lanes=1) if self.in_turns else self

    @property
    def takes_together(self) -> bool:
        """Whether new rays are taken only together."""
        return self.top_level.takes_together and self.task is VisitTask.TOP

    @property
    def replaces_at_once(self) -> bool:
        """QUANTISED: whether a lane takes a new ray as soon as its own has stopped."""
        return self.top_level is TopLevelTraversal.LONG_HAUL and self.task is VisitTask.TOP

    @property
    def in_turns(self) -> bool:
        """QUANTISED: whether the lanes of a warp vote in each turn (`traverse/quantised/together/loop.h`)."""
        return self.task is VisitTask.TOP and (self.top_level.elects or self.lanes > 1)

    @property
    def writes_queues(self) -> bool:
        """QUANTISED: whether the task writes queues in place of treelets: of treelet k 2 k, where rays wait to enter,
        and 2 k + 1, where they wait to go on behind it.
        """
        return self.task is VisitTask.TOP and self.top_level is TopLevelTraversal.SHORT_SEGMENT
