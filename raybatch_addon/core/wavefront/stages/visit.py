"""Stages of batched tracing: rays visit the top level, treelets, or all that is there. Next: the queue of the place where a ray stops.

One file for the three, which are one text (`VisitTask`) and are launched alike.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import warp as wp

from ...bvh.trace_counts import TraceCounts
from ...bvh.traverse_cpu import INTERLEAVE
from ...bvh.traverse_cpu_visit import visit_function
from ...bvh.traverse_cuda_visit import VisitOptions, quantised_visit_function
from ...bvh.tree import TopProgress, Tree, Treelets
from ...bvh.visit_task import VisitTask
from ...kernel import KERNEL_OPTIONS
from ...launches import RepeatedLaunches
from ..rays import Rays
from .launch import Launch, slice_first
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

    def prepare(self, device: wp.Device) -> None:
        """Allocate what launches need; otherwise the first one does."""

    def launch(
        self, tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: Batch, any_first: int, counts: TraceCounts | None
    ) -> None:
        """Do the task for the rays of `batch`, and write where they came to.

        Rays in slots from `any_first` on ask whether anything is hit before their `t_max`; the others for the closest hit. Of these
        `t_max` is read when they are `NEW`, and never again: it may be the same array as `hit_t`. With counters, `counts` of a `NEW` ray are set, and of others are added to.
        """


def visit_stage(features: VisitFeatures, launch: Launch = Launch()) -> VisitStage:
    """How `features.task` is done."""
    stages = {Traversal.BOXES: BoxesVisitStage, Traversal.QUANTISED: QuantisedVisitStage}
    return stages[features.traversal](features, launch)


@wp.struct
class VisitBatch:
    """A `Batch` as kernels see it, and how it is shared out."""

    slots: wp.array(dtype=int)
    where: wp.array(dtype=int)
    count: wp.array(dtype=int)
    any_first: int
    cursor: wp.array(dtype=int)  # rays that are taken, 0 before the launch, shape [1]; QUANTISED
    slice_count: int  # BOXES: each thread has one of so many parts


class _Stage:
    """What both have in common."""

    def __init__(self, kernel: wp.Kernel, counters: bool):
        self._kernel = kernel
        self._counters = counters
        self.kernels = (kernel,)

    def prepare(self, device: wp.Device) -> None:
        """Allocate what launches need; otherwise the first one does."""

    def _inputs(
        self, tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: VisitBatch, counts: TraceCounts | None
    ) -> list[Any]:
        return [tree, treelets, rays, progress, batch] + ([counts] if self._counters else [])


def _visit_batch(batch: Batch, any_first: int) -> VisitBatch:
    made = VisitBatch()
    made.slots, made.where, made.count, made.any_first = batch.slots, batch.where, batch.count, any_first
    return made


# --- QUANTISED


class QuantisedVisitStage(_Stage):
    """Persistent warps; on the CPU one ray at a time, for tests."""

    def __init__(self, features: VisitFeatures, launch: Launch):
        together = features.interlocked and features.task is VisitTask.TOP
        options = VisitOptions(features.task, features.instancing, features.counters, 32 if together else 8, launch.single_lane)
        super().__init__(launch.declare(quantised_visit_kernel(options)), features.counters)
        self._launch = launch
        self._cursor: wp.array | None = None

    def prepare(self, device: wp.Device) -> None:
        if self._cursor is None:
            self._cursor = wp.zeros(1, dtype=int, device=device)

    def launch(
        self, tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: Batch, any_first: int, counts: TraceCounts | None
    ) -> None:
        device = rays.origin.device
        self.prepare(device)
        self._cursor.zero_()
        work = _visit_batch(batch, any_first)
        work.cursor = self._cursor
        inputs = self._inputs(tree, treelets, rays, progress, work, counts)
        lanes = self._launch.lane_count(batch.bound, device)
        wp.launch(self._kernel, lanes, inputs, device=device, block_dim=self._launch.block_size_on(device))


@functools.cache
def quantised_visit_kernel(options: VisitOptions) -> wp.Kernel:
    """Kernel (tree, treelets, rays, progress, batch), with counters also (counts)."""
    visit = quantised_visit_function(options)
    if options.counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def visit_counted(
            tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: VisitBatch, counts: TraceCounts
        ):  # fmt: skip
            visit(
                tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
                rays.hit_primitive, rays.hit_uv, batch.slots, batch.where, batch.count, batch.cursor, batch.any_first, wp.tid(), counts,
            )  # fmt: skip

        return visit_counted

    @wp.kernel(**KERNEL_OPTIONS)
    def visit_quantised(tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: VisitBatch):
        visit(
            tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
            rays.hit_primitive, rays.hit_uv, batch.slots, batch.where, batch.count, batch.cursor, batch.any_first, wp.tid(),
        )  # fmt: skip

    return visit_quantised


# --- BOXES


class BoxesVisitStage(_Stage):
    """One thread, on the CPU."""

    def __init__(self, features: VisitFeatures, launch: Launch):
        interleave = 1 if launch.single_lane else INTERLEAVE
        kernel = boxes_visit_kernel(features.task, features.instancing, interleave, features.counters, features.interlocked)
        super().__init__(kernel, features.counters)
        self._launches = RepeatedLaunches(wp.get_device("cpu"))
        self._slice_count = launch.slice_count

    def launch(
        self, tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: Batch, any_first: int, counts: TraceCounts | None
    ) -> None:
        work = _visit_batch(batch, any_first)
        work.slice_count = self._slice_count
        self._launches.launch(self._kernel, self._slice_count, *self._inputs(tree, treelets, rays, progress, work, counts))


@functools.cache
def boxes_visit_kernel(task: VisitTask, instancing: bool, interleave: int, counters: bool, interlocked: bool) -> wp.Kernel:
    """Kernel (tree, treelets, rays, progress, batch), with counters also (counts), of `batch.slice_count` threads."""
    visit = visit_function(task, instancing, interleave, counters, interlocked)
    if counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def visit_counted(
            tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: VisitBatch, counts: TraceCounts
        ):  # fmt: skip
            first = slice_first(batch.count[0], wp.tid(), batch.slice_count)
            end = slice_first(batch.count[0], wp.tid() + 1, batch.slice_count)
            visit(
                tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
                rays.hit_primitive, rays.hit_uv, batch.slots, batch.where, first, end, batch.any_first, counts,
            )  # fmt: skip

        return visit_counted

    @wp.kernel(**KERNEL_OPTIONS)
    def visit_boxes(tree: Tree, treelets: Treelets, rays: Rays, progress: TopProgress, batch: VisitBatch):
        first = slice_first(batch.count[0], wp.tid(), batch.slice_count)
        end = slice_first(batch.count[0], wp.tid() + 1, batch.slice_count)
        visit(
            tree, treelets, progress, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance,
            rays.hit_primitive, rays.hit_uv, batch.slots, batch.where, first, end, batch.any_first,
        )  # fmt: skip

    return visit_boxes
