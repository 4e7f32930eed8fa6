"""Options that traversals of the own trees are compiled for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

from .task import VisitTask

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
    interlocked: bool = False  # in TOP, new rays are taken only when all that are carried have stopped
    tiers: bool = False  # in TOP, there are large treelets

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.refill:
            raise ValueError("refill is 1..32")

    @property
    def takes_together(self) -> bool:
        """Whether new rays are taken only together."""
        return self.interlocked and self.task is VisitTask.TOP
