"""Traversal by a warp of the streaming schedule: of the rays in its hands, by the code that kernels of the
wavefront call for lists.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...bvh.node import Layout
from ...bvh.traverse.counts import TraceCounts
from ...bvh.traverse.cpu import make_cpu_traversal
from ...bvh.traverse.cpu_visit import visit_function
from ...bvh.traverse.cuda import trace_function
from ...bvh.traverse.cuda_visit import quantised_visit_function
from ...bvh.traverse.options import TraceOptions, VisitOptions
from ...bvh.traverse.task import VisitTask
from ...bvh.tree import DONE, TopProgress, Tree, Treelets
from ...rays import NO_ANY_HIT, DeviceRayList, Rays
from ...scene.features import SceneFeatures
from ..plan.plan import Method
from ..plan.tracing import Tracing
from ..rays import Paths, Status
from .queues import Queue, StreamQueues, Word, join_lanes, lane_count
from .stages import settle

_BACKGROUND, _SURFACE, _CONNECT = int(Queue.BACKGROUND), int(Queue.SURFACE), int(Queue.CONNECT)
_SHADOW, _TRACE, _TREELETS = int(Queue.SHADOW), int(Queue.TRACE), int(Queue.TREELETS)
_HELD, _CURSOR, _HIT = int(Word.HELD), int(Word.CURSOR), int(Status.HIT)


@dataclass(frozen=True, kw_only=True)
class StreamTracing:
    """How rays are traced; what kernels are specialised on."""

    layout: Layout
    instancing: bool
    curves: bool
    moving: bool
    cut: bool  # rays wait at treelets
    any_hits: bool  # shadow rays ask whether anything is hit

    @property
    def common(self) -> dict[str, bool]:
        """Arguments of the options of traversals."""
        return {"instancing": self.instancing, "curves": self.curves, "motion": self.moving}


def stream_tracing(tracing: Tracing, features: SceneFeatures) -> StreamTracing | None:
    """How rays of a scene with `features` are traced; None: there is nothing to hit."""
    if not features.surfaces:
        return None
    return StreamTracing(
        layout=tracing.layout,
        instancing=tracing.instancing,
        curves=tracing.curves,
        moving=tracing.moving,
        cut=tracing.method is Method.BATCHED,
        any_hits=features.shadow_rays and not features.transparency,
    )


@wp.struct
class TracedTree:
    """The tree of a scene, whole or cut."""

    tree: Tree
    treelets: Treelets
    progress: TopProgress
    location: wp.array(dtype=int)  # by ray slot: `NEW` or the treelet at which it waits; where the tree is cut
    counts: TraceCounts  # without entries: nothing is counted


@wp.func
def _back_to(paths: Paths, rays: Rays, slots: wp.array(dtype=int), one: wp.array(dtype=int)) -> int:
    """The queue that a ray goes to that is back."""
    slot = slots[0]
    if slot >= paths.status.shape[0]:
        return wp.static(_CONNECT)
    settle(paths, rays, slots, one)
    if (paths.status[slot] & wp.static(_HIT)) != 0:
        return wp.static(_SURFACE)
    return wp.static(_BACKGROUND)


@functools.cache
def make_trace_batch(tracing: StreamTracing | None) -> wp.Function:
    """Function (traced, paths, rays, queues, one, queue: int, thread: int): the rays in the hands of a warp, which are
    from `queue`, are traced, and get their targets. All lanes call it together. None: there is nothing to hit.
    """
    if tracing is None:
        return _trace_nothing
    return _make_trace_cut(tracing) if tracing.cut else _make_trace_whole(tracing)


@wp.func
def _trace_nothing(
    traced: TracedTree,
    paths: Paths,
    rays: Rays,
    queues: StreamQueues,
    one: wp.array(dtype=int),
    queue: int,
    thread: int,
):
    number = thread / lane_count()
    for i in range(thread % lane_count(), queues.warps[number, _HELD], lane_count()):
        queues.targets[number, i] = _back_to(paths, rays, queues.tokens[number][i : i + 1], one)


@wp.func
def _listed(queues: StreamQueues, number: int, any_first: int) -> DeviceRayList:
    """The rays in the hands of warp `number`."""
    listed = DeviceRayList()
    listed.slots = queues.tokens[number]
    listed.locations = queues.locations[number]
    listed.count = queues.warps[number][_HELD : _HELD + 1]
    listed.any_first = any_first
    return listed


def _make_trace_whole(tracing: StreamTracing) -> wp.Function:
    closest = _make_trace(tracing, False)
    occluded = _make_trace(tracing, True) if tracing.any_hits else None

    @wp.func
    def trace_whole(
        traced: TracedTree,
        paths: Paths,
        rays: Rays,
        queues: StreamQueues,
        one: wp.array(dtype=int),
        queue: int,
        thread: int,
    ):
        number = thread / lane_count()
        listed = _listed(queues, number, wp.static(NO_ANY_HIT))
        cursor = queues.warps[number][_CURSOR : _CURSOR + 1]
        if wp.static(occluded is not None):
            if queue == _SHADOW:
                occluded(traced, rays, listed, cursor, thread)
            else:
                closest(traced, rays, listed, cursor, thread)
        else:
            closest(traced, rays, listed, cursor, thread)
        join_lanes()
        for i in range(thread % lane_count(), listed.count[0], lane_count()):
            queues.targets[number, i] = _back_to(paths, rays, listed.slots[i : i + 1], one)

    return trace_whole


def _make_trace_cut(tracing: StreamTracing) -> wp.Function:
    """Rays that begin, or come from a treelet, go through the top level; others visit the treelet that they wait at."""
    go_on, visit = _make_visit(tracing, VisitTask.TOP), _make_visit(tracing, VisitTask.TREELET)

    @wp.func
    def trace_cut(
        traced: TracedTree,
        paths: Paths,
        rays: Rays,
        queues: StreamQueues,
        one: wp.array(dtype=int),
        queue: int,
        thread: int,
    ):
        number = thread / lane_count()
        first = thread % lane_count()
        any_first = int(wp.static(NO_ANY_HIT))
        if wp.static(tracing.any_hits):
            any_first = paths.status.shape[0]
        listed = _listed(queues, number, any_first)
        cursor = queues.warps[number][_CURSOR : _CURSOR + 1]
        for i in range(first, listed.count[0], lane_count()):
            listed.locations[i] = traced.location[listed.slots[i]]
        join_lanes()
        if queue == _TRACE:
            go_on(traced, rays, listed, cursor, thread)
        else:
            visit(traced, rays, listed, cursor, thread)
        join_lanes()
        for i in range(first, listed.count[0], lane_count()):
            location = listed.locations[i]
            traced.location[listed.slots[i]] = location
            target = int(_TRACE)
            if location == wp.static(DONE):
                target = _back_to(paths, rays, listed.slots[i : i + 1], one)
            elif queue == _TRACE:
                target = _TREELETS + 1 + location
            queues.targets[number, i] = target

    return trace_cut


def _make_trace(tracing: StreamTracing, any_hit: bool) -> wp.Function:
    """Function (traced, rays, listed, cursor, thread): the rays of `listed` go through the whole tree."""
    options = TraceOptions(any_hit=any_hit, **tracing.common)
    if tracing.layout is Layout.BOXES:
        trace_boxes = make_cpu_traversal(options)

        @wp.func
        def trace(traced: TracedTree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), thread: int):
            trace_boxes(traced.tree, rays, listed, 0, listed.count[0], traced.counts)

        return trace
    trace_quantised = trace_function(options)

    @wp.func
    def trace(traced: TracedTree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), thread: int):
        trace_quantised(traced.tree, rays, listed, cursor, thread, traced.counts)

    return trace


def _make_visit(tracing: StreamTracing, task: VisitTask) -> wp.Function:
    """Function (traced, rays, listed, cursor, thread): `task` for the rays of `listed`, which are moved."""
    options = VisitOptions(task=task, **tracing.common)
    if tracing.layout is Layout.BOXES:
        visit_boxes = visit_function(options)

        @wp.func
        def visit(traced: TracedTree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), thread: int):
            visit_boxes(traced.tree, traced.treelets, traced.progress, rays, listed, 0, listed.count[0], traced.counts)

        return visit
    visit_quantised = quantised_visit_function(options)

    @wp.func
    def visit(traced: TracedTree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), thread: int):
        visit_quantised(traced.tree, traced.treelets, traced.progress, rays, listed, cursor, thread, traced.counts)

    return visit
