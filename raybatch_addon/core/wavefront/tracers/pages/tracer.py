"""The tracer of scenes that are larger than the device's memory.

Rays go on through all that is on the device, and where they come to a page that is not, they wait for it. Pages that
most rays wait for are brought in first, so that each is copied once for many of them (`policy.py`). Copies and
tracing go on at the same time:

    host     step i launched | counts of step i-1 read | pages for step i+1 chosen, copies begun, behind those for step
    i device   tracing of step i (its pages have arrived)
    copies   pages for step i+1, into slots that no launch since step i sees

A page leaves one step before its slot is filled again, so that a copy waits for a launch that is over, and the counts
that decide are one step old, so that the device never waits for the host. On the CPU, where launches return when they
are over, both are exact, and threads read pages while rays are traced.
"""

from __future__ import annotations

import functools
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ....bvh.node import Layout
from ....bvh.pages.encode import PAGE_KERNELS
from ....bvh.pages.paged_scene import PagedScene
from ....bvh.pages.residency import Residency, address_kernel
from ....bvh.pages.transfer import pages_a_step
from ....measure.batching import BatchingTotals, PageWaits
from ....rays import NO_ANY_HIT, RayKind, RayList
from ....settings.settings import RenderSettings
from ...plan.plan import has_tiers
from ...rays import allocate_progress, trail_words
from ..visit import VisitStage
from ..worker_rays import WorkerRays
from .kernels import streaming_kernels
from .policy import choose_pages, choose_victims, copies_pay
from .rays import PendingCounts, RayCounts, WaitingRays, page_batch_capacity, streaming_bytes_per_slot
from .stages import SORT_BYTES, page_stage

# Rays that begin in a step at most: few enough that the first pages are on their way early
_NEW_CUDA, _NEW_CPU = 1 << 24, 1 << 16
# `advance` returns when this share of the rays alive is finished
_FINISHED_SHARE = 8
# A worker that waited this long for a page takes the place of pages that other workers wait for [s]
PATIENCE = 1.0


def streaming_bytes_per_path(settings: RenderSettings, path_count: int, shadow_rays: bool, levels: int) -> int:
    """Device memory of the tracer that grows with paths alive, for each [bytes]."""
    slots = 1 + shadow_rays
    count = slots * path_count
    order = SORT_BYTES * page_batch_capacity(count) / count if has_tiers(settings) else 0
    return math.ceil(slots * (streaming_bytes_per_slot(count) + order + 4 + 4 * trail_words(levels)))


def compiled_ahead(
    layout: Layout, counters: bool, settings: RenderSettings, curves: bool = False, moving: bool = False
) -> list[wp.Kernel]:
    """Kernels of a `StreamingTracer`."""
    stage = page_stage(layout, counters, settings, curves, moving)
    return [*streaming_kernels(), address_kernel, *PAGE_KERNELS, *stage.kernels]


@dataclass(frozen=True)
class _Pending:
    """A step whose counts were not read yet."""

    step: int
    shown: np.ndarray  # numbers of the pages that its launches saw
    counts: PendingCounts


class StreamingTracer:
    """A `Tracer` whose rays wait for pages of geometry."""

    def __init__(
        self,
        paged: PagedScene,
        residency: Residency,
        worker: WorkerRays,
        settings: RenderSettings,
        *,
        stage: VisitStage | None = None,
        capacity: int = 0,
        curves: bool = False,
        moving: bool = False,
    ):
        """Traces the rays of `worker`, past segments of curves where there are `curves`, and at their times where
        things are `moving`; `residency`, of the same scene, is shared by all workers. To be closed.

        `stage`: what tracing does. `capacity`: rays of a batch at most. Where these are not given they are chosen.
        """
        device, slot_count, path_count = worker.device, worker.slot_count, worker.path_count
        self._paged, self._residency, self._rays, self._device = paged, residency, worker.rays, device
        self._shadow_kind, self._timer, self._trace_counts = worker.shadow_kind, worker.timer, worker.counts
        self._any_first = path_count if worker.shadow_kind == RayKind.OCCLUSION else NO_ANY_HIT
        self._debug = settings.is_on("debug_checks")
        self._stage = stage or page_stage(paged.layout, worker.counts is not None, settings, curves, moving)
        self._progress = allocate_progress(slot_count, trail_words(paged.levels), True, device)
        self._waiting = WaitingRays(slot_count, path_count, residency.page_of, len(paged.pages), device, capacity)
        self._view = residency.view()
        self._slot_count = slot_count
        self._new_most = min(self._waiting.capacity, _NEW_CUDA if device.is_cuda else _NEW_CPU)
        self._all_pages = np.arange(len(paged.pages))
        self._step_pages = pages_a_step(paged, residency.slot_count)
        # on CUDA the counts of one step are read while the next runs
        self._lag = 1 if device.is_cuda and not self._debug else 0
        self._pending: deque[_Pending] = deque()
        self._known = RayCounts(
            idle=slot_count,
            new=0,
            done_closest=0,
            done_shadow=0,
            waiting=np.zeros(len(paged.pages), np.int64),
            taken=0,
            visits=0,
        )
        self._submitted = 0  # bound of rays that came in since the last step
        self._alive = 0  # rays that are not idle at most: counts that are one step old do not know the newest
        self._new_expected = 0  # rays that are new behind the last step, as far as the host knows
        self._zero_copy = False
        self._totals = BatchingTotals()
        self._forgotten = 0  # rays that were given up
        self._waits = PageWaits(len(paged.pages))
        self._start = time.perf_counter()

    def __del__(self):
        if hasattr(self, "_view"):
            self.close()

    # --- the tracer

    def submit(self, kind: RayKind, rays: RayList) -> None:
        """See `Tracer.submit`."""
        if not rays.bound:
            return
        if self._debug:
            self._waiting.check_idle(rays)
        with self._timer.stage("queue"):
            self._waiting.submit(rays)
        self._submitted += rays.bound
        self._alive += rays.bound
        self._zero_copy = False

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """See `Tracer.advance`: an eighth of the rays alive is finished, or all."""
        goal = max(1, min(self._alive // _FINISHED_SHARE, self._waiting.capacity))
        while True:
            worked = self._step()
            if self._known.done >= goal or self._is_over():
                break
            if not worked:
                self._wait()
            if stop and stop():
                break
        # the device comes to rest here, copies go on
        while self._pending:
            self._read_counts()
        self._alive = self._slot_count - self._known.idle
        self._ask(2 * self._step_pages)

    def take_finished(self) -> list[tuple[RayKind, RayList]]:
        """See `Tracer.take_finished`; the lists are valid until `advance`."""
        with self._timer.stage("queue"):
            lists = self._waiting.take_done(self._known)
        if not lists:
            return []
        handed = sum(rays.bound for _, rays in lists)
        self._totals.finished += handed
        self._alive -= handed
        closest = sum(rays.bound for shadow, rays in lists if not shadow)
        known = self._known
        self._known = RayCounts(
            idle=known.idle + handed,
            new=known.new,
            done_closest=known.done_closest - closest,
            done_shadow=known.done_shadow - (handed - closest),
            waiting=known.waiting,
            taken=0,
            visits=known.visits,
        )
        if self._debug and not self._submitted:
            self._waiting.check(self._known)
        return [(self._shadow_kind if shadow else RayKind.CLOSEST, rays) for shadow, rays in lists]

    def forget(self) -> None:
        """See `Tracer.forget`."""
        while self._pending:
            self._read_counts()
        # those that came in since the last step too
        known = self._waiting.count(self._progress.visits).read()
        self._forgotten += self._slot_count - known.idle
        self._waiting.clear()
        self._known = RayCounts(
            idle=self._slot_count,
            new=0,
            done_closest=0,
            done_shadow=0,
            waiting=np.zeros_like(known.waiting),
            taken=0,
            visits=known.visits,
        )
        self._waits.forget()
        self._view.set_waiting(self._known.waiting)
        self._submitted = self._alive = self._new_expected = 0
        self._zero_copy = False

    def totals(self) -> BatchingTotals:
        """What was done so far."""
        while self._pending:
            self._read_counts()
        totals, pages = self._totals, self._view.counts
        totals.bytes_copied, totals.pages_loaded, totals.pages_evicted = pages.bytes_copied, pages.loaded, pages.evicted
        totals.resident_peak = self._residency.bytes_peak
        totals.treelet_visits = self._known.visits
        totals.rays = totals.finished + self._forgotten + self._slot_count - self._known.idle
        return totals

    def release(self) -> None:
        """See `Tracer.release`: nothing is captured; nobody waits here, or holds pages, until rays come again. A
        traceback may keep this tracer after an error, whose rays will never go on: others need its pages.
        """
        self._view.close()

    def close(self) -> None:
        """Nobody waits here any more; rays under way are given up."""
        if self._device.is_cuda:
            # launches that are under way see pages, and write counts
            while self._pending:
                self._pending.popleft().counts.read()
        self._view.close()

    # --- steps

    def _step(self) -> bool:
        """Launch a step if there may be rays for it, read the counts of the one before, and choose pages; whether
        anything was done.
        """
        if self._lag and not self._zero_copy:
            # what leaves now is not seen by this step, so that copies for the next begin at once
            wanted = int(np.count_nonzero(self._known.waiting[~self._residency.there()]))
            self._residency.make_room(choose_victims, min(self._step_pages, wanted), self._view.counts)
        launched = self._has_work()
        if launched:
            self._launch()
        worked = launched or bool(self._pending)
        if len(self._pending) > (self._lag if launched else 0):
            self._read_counts()
        return bool(self._ask(self._step_pages)) or worked

    def _has_work(self) -> bool:
        """Whether rays may be new, or wait for pages that are there. Where the counts are old it may be too late, never
        for good.
        """
        if self._submitted or self._new_expected or self._known.new or self._zero_copy:
            return True
        return bool((self._known.waiting[self._residency.there()] > 0).any())

    def _launch(self) -> None:
        view, waiting = self._view, self._waiting
        with self._timer.stage("copy"):
            view.begin(self._zero_copy)
        shown = self._all_pages if self._zero_copy else view.shown
        try:
            with self._timer.stage("queue"):
                batch = waiting.take(view.treelets.triangles, self._new_most, self._alive)
            with self._timer.stage("trace"):
                self._stage.launch(
                    self._paged.tree,
                    view.treelets,
                    self._rays,
                    self._progress,
                    batch,
                    self._any_first,
                    self._trace_counts,
                )
        finally:
            view.end()
        with self._timer.stage("queue"):
            waiting.put(batch)
            self._pending.append(_Pending(self._totals.steps, shown, waiting.count(self._progress.visits)))
        self._new_expected, self._submitted = max(0, self._new_expected + self._submitted - self._new_most), 0
        self._totals.steps += 1

    def _read_counts(self) -> None:
        pending, before = self._pending.popleft(), self._known
        self._known = pending.counts.read()
        known, totals = self._known, self._totals
        self._view.set_waiting(known.waiting)
        totals.rays_queued += known.taken - (known.done - before.done)
        # a batch that is full may have left rays of pages that were there
        served = pending.shown if known.taken < self._waiting.capacity else pending.shown[:0]
        self._waits.note(pending.step, known.waiting, served)
        totals.wait_max = self._waits.longest
        totals.note_occupancy(time.perf_counter() - self._start, int(known.waiting.sum()))
        if self._debug:
            self._waiting.check(known)

    def _ask(self, pages: int) -> list[int]:
        """Bring in what rays wait for, or let them go on through pinned memory if they are too few for that."""
        known, residency = self._known, self._residency
        there = residency.there()
        away = np.where(there, 0, known.waiting)
        alone, self._zero_copy = self._zero_copy, False
        if not away.any():
            return []
        if residency.has_zero_copy and not (
            known.new or self._submitted or self._new_expected or residency.is_coming()
        ):
            most = int(away.argmax())
            if not copies_pay(int(away[most]), self._paged.pages[most].byte_count, self._paged.nodes_resident):
                # rays that are being traced may still make it worth it
                self._zero_copy = not known.waiting[there].any()
                if self._zero_copy and not alone:
                    self._totals.rays_unbatched += int(away.sum())
                return []
        return residency.ask(choose_pages, choose_victims, pages, self._view.counts)

    def _is_over(self) -> bool:
        known = self._known
        return not (self._pending or self._submitted or known.new or known.waiting.any())

    def _wait(self) -> None:
        """Nothing can go on until a page arrives. If none does for long, one that others wait for makes room: they may
        have given up.
        """
        residency, changes = self._residency, self._residency.changes
        with self._timer.stage("copy"):
            if not self._has_work() and not residency.wait(changes, PATIENCE) and not residency.is_coming():
                forced = functools.partial(choose_victims, forced=True)
                residency.ask(choose_pages, forced, self._step_pages, self._view.counts)
