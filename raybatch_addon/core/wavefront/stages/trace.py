"""Stage: rays visit the whole tree at once. Next: `connect` for shadow rays, shading for the others."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

import warp as wp

from ...bvh.node import Layout
from ...bvh.reference import ReferenceTree, make_reference
from ...bvh.trace_counts import TraceCounts
from ...bvh.traverse_cpu import INTERLEAVE, make_cpu_traversal
from ...bvh.traverse_cuda import TraceOptions, trace_function
from ...bvh.tree import Tree
from ...kernel import KERNEL_OPTIONS
from ...launches import RepeatedLaunches
from ..rays import RayKind, Rays
from ..tracer import SlotList
from .launch import Launch, slice_first


class Traversal(Enum):
    """Which tree rays visit, and how."""

    REFERENCE = "Warp's tree, one thread a ray"
    BOXES = "the own tree, several rays at a time on one thread"
    QUANTISED = "the own tree, persistent warps"

    @staticmethod
    def of(batching: str, layout: Layout) -> Traversal:
        """The traversal for the setting `batching` and the layout of the tree."""
        if batching == "REFERENCE":
            return Traversal.REFERENCE
        return Traversal.BOXES if layout is Layout.BOXES else Traversal.QUANTISED


@dataclass(frozen=True)
class TraceFeatures:
    """What the stage is specialised on."""

    traversal: Traversal
    any_hit: bool  # whether anything is hit, instead of the closest hit
    instancing: bool
    counters: bool
    plain: bool = False  # of the own tree, to compare with: one ray after another a thread, and no refill


class TraceStage(Protocol):
    """Traces lists of rays of one kind."""

    kernels: tuple[wp.Kernel, ...]

    def launch(self, tree: Any, rays: Rays, listed: SlotList, counts: TraceCounts | None) -> None:
        """Trace the rays of `listed`; hits go to their slots, what was counted to `counts`."""


def trace_stage(features: TraceFeatures, launch: Launch = Launch()) -> TraceStage:
    """How rays are traced. Warp's tree is traced the same way whatever `launch` says."""
    stages = {Traversal.REFERENCE: ReferenceStage, Traversal.BOXES: BoxesStage, Traversal.QUANTISED: QuantisedStage}
    return stages[features.traversal](features, launch)


def tracing_stages(traversal: Traversal, instancing: bool, counters: bool, launch: Launch = Launch()) -> dict[RayKind, TraceStage]:
    """The stages by what is asked of a ray."""
    closest = trace_stage(TraceFeatures(traversal, False, instancing, counters), launch)
    return {
        RayKind.CLOSEST: closest,
        RayKind.OCCLUSION: trace_stage(TraceFeatures(traversal, True, instancing, counters), launch),
        RayKind.TRANSPARENT_SHADOW: closest,  # closest hits, in order
    }


# --- the own tree


class BoxesStage:
    """One thread, on the CPU."""

    def __init__(self, features: TraceFeatures, launch: Launch):
        self._counters = features.counters
        interleave = 1 if features.plain or launch.single_lane else INTERLEAVE
        self._slice_count = launch.slice_count
        make = sliced_boxes_kernel if self._slice_count > 1 else boxes_kernel
        self._kernel = make(features.any_hit, features.instancing, features.counters, interleave)
        self._launches = RepeatedLaunches(wp.get_device("cpu"))
        self.kernels = (self._kernel,)

    def launch(self, tree: Tree, rays: Rays, listed: SlotList, counts: TraceCounts | None) -> None:
        inputs = [tree, rays, listed.slots, listed.count]
        if self._slice_count > 1:
            inputs.append(self._slice_count)
        if self._counters:
            inputs.append(counts)
        self._launches.launch(self._kernel, self._slice_count, *inputs)


@functools.cache
def boxes_kernel(any_hit: bool, instancing: bool, counters: bool, interleave: int) -> wp.Kernel:
    """Kernel (tree, rays, slots, count), with counters also (counts), launched once: trace the first `count[0]` of `slots`."""
    trace = make_cpu_traversal(any_hit, instancing, interleave, counters)
    if counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def trace_counted(tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), counts: TraceCounts):
            trace(
                tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
                rays.hit_uv, slots, 0, count[0], counts,
            )  # fmt: skip

        return trace_counted

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_boxes(tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
        trace(
            tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
            rays.hit_uv, slots, 0, count[0],
        )  # fmt: skip

    return trace_boxes


@functools.cache
def sliced_boxes_kernel(any_hit: bool, instancing: bool, counters: bool, interleave: int) -> wp.Kernel:
    """As `boxes_kernel`, with (slice_count) before counts, and launched with so many threads."""
    trace = make_cpu_traversal(any_hit, instancing, interleave, counters)
    if counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def trace_counted_slice(
            tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), slice_count: int, counts: TraceCounts
        ):
            trace(
                tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
                rays.hit_uv, slots, slice_first(count[0], wp.tid(), slice_count), slice_first(count[0], wp.tid() + 1, slice_count), counts,
            )  # fmt: skip

        return trace_counted_slice

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_slice(tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), slice_count: int):
        trace(
            tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
            rays.hit_uv, slots, slice_first(count[0], wp.tid(), slice_count), slice_first(count[0], wp.tid() + 1, slice_count),
        )  # fmt: skip

    return trace_slice


class QuantisedStage:
    """Persistent warps; on the CPU one ray at a time, for tests."""

    def __init__(self, features: TraceFeatures, launch: Launch):
        options = TraceOptions(features.any_hit, features.instancing, features.counters, single_lane=launch.single_lane)
        self._options = replace(options, refill=0) if features.plain and not launch.single_lane else options
        self._launch = launch
        self._kernel = launch.declare(quantised_kernel(self._options))
        self._cursor: wp.array | None = None
        self.kernels = (self._kernel,)

    def launch(self, tree: Tree, rays: Rays, listed: SlotList, counts: TraceCounts | None) -> None:
        device = rays.origin.device
        if self._cursor is None:
            self._cursor = wp.zeros(1, dtype=int, device=device)
        else:
            self._cursor.zero_()
        inputs = [tree, rays, listed.slots, listed.count, self._cursor]
        if self._options.counters:
            inputs.append(counts)
        threads = self._launch.lane_count(listed.bound, device) if self._options.refill else listed.bound
        wp.launch(self._kernel, threads, inputs, device=device, block_dim=self._launch.block_size_on(device))


@functools.cache
def quantised_kernel(options: TraceOptions) -> wp.Kernel:
    """Kernel (tree, rays, slots, count, cursor), with counters also (counts): trace the first `count[0]` of `slots`."""
    trace = trace_function(options)
    if options.counters:

        @wp.kernel(**KERNEL_OPTIONS)
        def trace_counted(
            tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), cursor: wp.array(dtype=int), counts: TraceCounts
        ):
            trace(
                tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
                rays.hit_uv, slots, count, cursor, wp.tid(), counts,
            )  # fmt: skip

        return trace_counted

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_quantised(
        tree: Tree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int), cursor: wp.array(dtype=int)
    ):
        trace(
            tree, rays.origin, rays.direction, rays.t_max, rays.visibility, rays.hit_t, rays.hit_instance, rays.hit_primitive,
            rays.hit_uv, slots, count, cursor, wp.tid(),
        )  # fmt: skip

    return trace_quantised


# --- Warp's tree


class ReferenceStage:
    """One thread a ray; nothing is counted."""

    def __init__(self, features: TraceFeatures, launch: Launch):
        self._kernel = reference_kernel(features.any_hit, features.instancing)
        self.kernels = (self._kernel,)

    def launch(self, tree: ReferenceTree, rays: Rays, listed: SlotList, counts: TraceCounts | None) -> None:
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
