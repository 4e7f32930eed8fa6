"""Stages of batched tracing: rays visit the top level, treelets, or all that is there. Next: the queue of the location
at which a ray stops.

One file for the three tasks (`VisitTask`), which are made from the same headers and launched alike.
"""

from __future__ import annotations

import functools
from typing import Protocol

import warp as wp

from ...bvh.node import Layout
from ...bvh.traverse.counts import NO_COUNTS, TraceCounts
from ...bvh.traverse.cpu_visit import visit_function
from ...bvh.traverse.cuda_visit import quantised_visit_function
from ...bvh.traverse.options import VisitOptions
from ...bvh.tree import TopProgress, Tree, Treelets
from ...device.kernel import KERNEL_OPTIONS
from ...device.launches import RepeatedLaunches
from ...rays import DeviceRayList, RayList, Rays, fill_list
from ..plan.launch import Launch, slice_first


class VisitStage(Protocol):
    """One task for batches of rays of all kinds and bounces."""

    kernels: tuple[wp.Kernel, ...]
    writes_queues: bool  # locations are queues in place of treelets (`VisitOptions.writes_queues`)

    def prepare(self, device: wp.Device) -> None:
        """Allocate what launches need; otherwise the first one does."""

    def launch(
        self,
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        batch: RayList,
        any_first: int,
        counts: TraceCounts | None,
    ) -> None:
        """Do the task for the rays of `batch`, and write where they came to.

        Rays in slots from `any_first` on ask whether anything is hit before their `t_max`; the others for the closest
        hit. Of these `t_max` is read when they are `NEW`, and never again: it may be the same array as `hit_t`. With
        counters, `counts` of a `NEW` ray are set, and of others are added to.
        """


def visit_stage(layout: Layout, options: VisitOptions, launch: Launch = Launch()) -> VisitStage:
    """How `options.task` is done in a tree of `layout`."""
    if launch.single_lane:
        options = options.one_at_a_time()
    if layout is Layout.BOXES:
        return BoxesVisitStage(options.without_warps(), launch)
    return QuantisedVisitStage(options, launch)


class _Stage:
    """The common part of both visit stages."""

    def __init__(self, kernel: wp.Kernel, options: VisitOptions):
        self._kernel = kernel
        self._listed = DeviceRayList()
        self.kernels, self.writes_queues = (kernel,), options.writes_queues

    def prepare(self, device: wp.Device) -> None:
        """Allocate what launches need; otherwise the first one does."""


# --- QUANTISED


class QuantisedVisitStage(_Stage):
    """Persistent warps; on the CPU one ray at a time, for tests."""

    def __init__(self, options: VisitOptions, launch: Launch):
        super().__init__(launch.declare(quantised_visit_kernel(options)), options)
        self._launch = launch
        self._cursor: wp.array | None = None

    def prepare(self, device: wp.Device) -> None:
        if self._cursor is None:
            self._cursor = wp.zeros(1, dtype=int, device=device)

    def launch(
        self,
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        batch: RayList,
        any_first: int,
        counts: TraceCounts | None,
    ) -> None:
        device = rays.origin.device
        self.prepare(device)
        self._cursor.zero_()
        fill_list(self._listed, batch, any_first)
        inputs = [tree, treelets, rays, progress, self._listed, self._cursor, counts or NO_COUNTS]
        lanes = self._launch.lane_count(batch.bound, device)
        wp.launch(self._kernel, lanes, inputs, device=device, block_dim=self._launch.block_size_on(device))


@functools.cache
def quantised_visit_kernel(options: VisitOptions) -> wp.Kernel:
    """Kernel (tree, treelets, rays, progress, listed, cursor, counts)."""
    visit = quantised_visit_function(options)

    @wp.kernel(**KERNEL_OPTIONS)
    def visit_quantised(
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        listed: DeviceRayList,
        cursor: wp.array(dtype=int),
        counts: TraceCounts,
    ):
        visit(tree, treelets, progress, rays, listed, cursor, wp.tid(), counts)

    return visit_quantised


# --- BOXES


class BoxesVisitStage(_Stage):
    """One thread, on the CPU."""

    def __init__(self, options: VisitOptions, launch: Launch):
        super().__init__(boxes_visit_kernel(options), options)
        self._launches = RepeatedLaunches(wp.get_device("cpu"))
        self._slice_count = launch.slice_count

    def launch(
        self,
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        batch: RayList,
        any_first: int,
        counts: TraceCounts | None,
    ) -> None:
        fill_list(self._listed, batch, any_first)
        inputs = (tree, treelets, rays, progress, self._listed, self._slice_count, counts or NO_COUNTS)
        self._launches.launch(self._kernel, self._slice_count, *inputs)


@functools.cache
def boxes_visit_kernel(options: VisitOptions) -> wp.Kernel:
    """Kernel (tree, treelets, rays, progress, listed, slice_count, counts), of `slice_count` threads."""
    visit = visit_function(options)

    @wp.kernel(**KERNEL_OPTIONS)
    def visit_boxes(
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        listed: DeviceRayList,
        slice_count: int,
        counts: TraceCounts,
    ):
        first = slice_first(listed.count[0], wp.tid(), slice_count)
        end = slice_first(listed.count[0], wp.tid() + 1, slice_count)
        visit(tree, treelets, progress, rays, listed, first, end, counts)

    return visit_boxes
