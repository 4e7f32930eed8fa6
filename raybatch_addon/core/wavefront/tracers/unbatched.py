"""Stage: rays visit the whole tree at once. Next: `connect` for shadow rays, shading for the others."""

from __future__ import annotations

import functools
from typing import Protocol

import warp as wp

from ...bvh.node import Layout
from ...bvh.traverse.counts import NO_COUNTS, TraceCounts
from ...bvh.traverse.cpu import make_cpu_traversal
from ...bvh.traverse.cuda import trace_function
from ...bvh.traverse.options import TraceOptions
from ...bvh.traverse.reference import ReferenceTree, make_reference
from ...bvh.tree import Tree
from ...device.kernel import KERNEL_OPTIONS
from ...device.launches import RepeatedLaunches
from ...rays import DeviceRayList, RayKind, RayList, Rays, fill_list
from ..plan.launch import Launch, slice_first


class TraceStage(Protocol):
    """Traces lists of rays of one kind."""

    kernels: tuple[wp.Kernel, ...]

    def launch(self, tree: Tree | ReferenceTree, rays: Rays, listed: RayList, counts: TraceCounts | None) -> None:
        """Trace the rays of `listed`; hits go to their slots, what was counted to `counts`."""


def trace_stage(layout: Layout | None, options: TraceOptions, launch: Launch = Launch()) -> TraceStage:
    """How rays are traced in a tree of `layout`; None: in Warp's tree, always the same way."""
    if layout is None:
        return ReferenceStage(options)
    if launch.single_lane:
        options = options.one_at_a_time()
    return (BoxesStage if layout is Layout.BOXES else QuantisedStage)(options, launch)


def tracing_stages(
    layout: Layout | None,
    instancing: bool,
    counters: bool,
    launch: Launch = Launch(),
    curves: bool = False,
    moving: bool = False,
) -> dict[RayKind, TraceStage]:
    """The stages by what is asked of a ray."""
    closest, occlusion = (
        trace_stage(
            layout,
            TraceOptions(any_hit=any_hit, instancing=instancing, counters=counters, curves=curves, motion=moving),
            launch,
        )
        for any_hit in (False, True)
    )
    return {
        RayKind.CLOSEST: closest,
        RayKind.OCCLUSION: occlusion,
        RayKind.TRANSPARENT_SHADOW: closest,  # closest hits, in order
    }


# --- the own tree


class BoxesStage:
    """One thread, on the CPU."""

    def __init__(self, options: TraceOptions, launch: Launch):
        self._kernel = boxes_kernel(options)
        self._slice_count = launch.slice_count
        self._listed = DeviceRayList()
        self._launches = RepeatedLaunches(wp.get_device("cpu"))
        self.kernels = (self._kernel,)

    def launch(self, tree: Tree, rays: Rays, listed: RayList, counts: TraceCounts | None) -> None:
        fill_list(self._listed, listed)
        inputs = (tree, rays, self._listed, self._slice_count, counts or NO_COUNTS)
        self._launches.launch(self._kernel, self._slice_count, *inputs)


@functools.cache
def boxes_kernel(options: TraceOptions) -> wp.Kernel:
    """Kernel (tree, rays, listed, slice_count, counts), of `slice_count` threads: trace the rays of `listed`."""
    trace = make_cpu_traversal(options)

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_boxes(tree: Tree, rays: Rays, listed: DeviceRayList, slice_count: int, counts: TraceCounts):
        first = slice_first(listed.count[0], wp.tid(), slice_count)
        end = slice_first(listed.count[0], wp.tid() + 1, slice_count)
        trace(tree, rays, listed, first, end, counts)

    return trace_boxes


class QuantisedStage:
    """Persistent warps; on the CPU one ray at a time, for tests."""

    def __init__(self, options: TraceOptions, launch: Launch):
        self._options = options
        self._launch = launch
        self._kernel = launch.declare(quantised_kernel(options))
        self._listed = DeviceRayList()
        self._cursor: wp.array | None = None
        self._launches: RepeatedLaunches | None = None
        self.kernels = (self._kernel,)

    def launch(self, tree: Tree, rays: Rays, listed: RayList, counts: TraceCounts | None) -> None:
        device = rays.origin.device
        if self._launches is None:
            self._cursor = wp.zeros(1, dtype=int, device=device)
            self._launches = RepeatedLaunches(device, self._launch.block_size_on(device))
        else:
            self._cursor.zero_()
        fill_list(self._listed, listed)
        inputs = (tree, rays, self._listed, self._cursor, counts or NO_COUNTS)
        threads = self._launch.lane_count(listed.bound, device) if self._options.refill else listed.bound
        self._launches.launch(self._kernel, threads, *inputs)


@functools.cache
def quantised_kernel(options: TraceOptions) -> wp.Kernel:
    """Kernel (tree, rays, listed, cursor, counts): trace the rays of `listed`."""
    trace = trace_function(options)

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_quantised(
        tree: Tree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), counts: TraceCounts
    ):
        trace(tree, rays, listed, cursor, wp.tid(), counts)

    return trace_quantised


# --- Warp's tree


class ReferenceStage:
    """One thread a ray; nothing is counted."""

    def __init__(self, options: TraceOptions):
        self._kernel = reference_kernel(options.any_hit, options.instancing)
        self.kernels = (self._kernel,)

    def launch(self, tree: ReferenceTree, rays: Rays, listed: RayList, counts: TraceCounts | None) -> None:
        wp.launch(self._kernel, listed.bound, [tree, rays, listed.slots, listed.count], device=rays.origin.device)


@functools.cache
def reference_kernel(any_hit: bool, instancing: bool) -> wp.Kernel:
    """Kernel (tree, rays, slots, count): trace the rays of the first `count[0]` of `slots`."""
    queries = make_reference(instancing)
    closest = queries.closest
    occluded = queries.occluded

    if not any_hit:

        @wp.kernel(**KERNEL_OPTIONS)
        def trace_closest(tree: ReferenceTree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
            i = wp.tid()
            if i >= count[0]:
                return
            slot = slots[i]
            hit = closest(tree, rays.origin[slot], rays.direction[slot], rays.t_max[slot], rays.visibility[slot])
            rays.hit_t[slot] = hit.t
            rays.hit_instance[slot] = hit.instance
            rays.hit_primitive[slot] = hit.primitive
            rays.hit_uv[slot] = hit.uv

        return trace_closest

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_occlusion(tree: ReferenceTree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
        i = wp.tid()
        if i >= count[0]:
            return
        slot = slots[i]
        rays.hit_instance[slot] = -1
        if occluded(tree, rays.origin[slot], rays.direction[slot], rays.t_max[slot], rays.visibility[slot]):
            rays.hit_instance[slot] = 0

    return trace_occlusion
