"""Stages of batched tracing: rays visit the top level, treelets, or all that is there. Next: the queue of the place where a ray stops.

One file for the three, which are one text (`VisitTask`) and are launched alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import warp as wp

from ...bvh.trace_counts import TraceCounts
from ...bvh.tree import TopProgress, Tree, Treelets
from ...bvh.visit_task import VisitTask
from ..rays import Rays
from .launch import Launch
from .trace import Traversal

__all__ = ["Batch", "Launch", "VisitFeatures", "VisitStage", "VisitTask", "visit_stage"]

NO_ANY_HIT = 2**31 - 1
"""As `any_first`: all rays ask for their closest hit."""


@dataclass(frozen=True)
class VisitFeatures:
    """What a stage is specialised on."""

    traversal: Traversal  # BOXES or QUANTISED
    task: VisitTask
    instancing: bool
    counters: bool
    interlocked: bool = False  # of TOP: lanes take new rays only together


@dataclass(frozen=True)
class Batch:
    """Rays on the device, each once, and where they wait."""

    slots: wp.array  # ray slots, int32, shape [>= bound]
    where: wp.array  # `NEW`, `DONE` or a treelet, int32, shape [>= bound]; the stage writes where each ray came to
    count: wp.array  # rays in the batch, int32, shape [1]
    bound: int  # at least `count[0]`


class VisitStage(Protocol):
    """One task for batches of rays of all kinds and bounces."""

    kernels: tuple[wp.Kernel, ...]

    def launch(
        self, tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: Batch, any_first: int, counts: TraceCounts | None
    ) -> None:
        """Do the task for the rays of `batch`, and write where they came to.

        Rays in slots from `any_first` on ask whether anything is hit before their `t_max`; the others for the closest hit. Of these `t_max` is
        read when they are `NEW`, and never again. With counters, `counts` of a `NEW` ray are set, and of others are added to.
        """


def visit_stage(features: VisitFeatures, launch: Launch = Launch()) -> VisitStage:
    """How `features.task` is done."""
    raise NotImplementedError(features)
