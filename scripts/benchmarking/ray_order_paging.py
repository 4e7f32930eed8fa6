"""The control of `StreamingTracer` on the CPU: rays in their order, pages as they come.

The same pages, pool and budget, and the same traversal; but rays are traced in their order, a small window at a time,
the first page that is missing is brought in at once, and the one that was not used for the longest time makes room.
That is what a system does that maps the file into memory and lets rays run into it, or a tracer with a plain cache of
geometry.

Use is known exactly, a window at a time: at its start all pages are hidden, and the rays that come to one which is
there (no copy is needed) show that it is in use.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.pages.facts import PageFacts
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.tree import DONE, NEW
from raybatch_addon.core.measure.batching import BatchingTotals
from raybatch_addon.core.rays import NO_ANY_HIT, RayKind, RayList
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import allocate_progress, trail_words
from raybatch_addon.core.wavefront.tracers.pages.stages import page_stage
from raybatch_addon.core.wavefront.tracers.pages.tracer import PATIENCE
from raybatch_addon.core.wavefront.tracers.visit import VisitStage
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays

WINDOW = 4096
"""Rays of a window."""


class RayOrderPager:
    """A `Tracer` for the CPU, to compare with: one worker, alone on its `Residency`."""

    def __init__(
        self,
        paged: PagedScene,
        residency: Residency,
        worker: WorkerRays,
        settings: RenderSettings,
        *,
        stage: VisitStage | None = None,
        window: int = WINDOW,
    ):
        """See `StreamingTracer`."""
        self._device, rays, counts = worker.device, worker.rays, worker.counts
        assert not self._device.is_cuda, "paging in the order of rays is a control for the CPU"
        self._paged, self._residency, self._rays, self._counts = paged, residency, rays, counts
        self._timer = worker.timer
        self._any_first = worker.path_count if worker.shadow_kind == RayKind.OCCLUSION else NO_ANY_HIT
        self._stage = stage or page_stage(paged.layout, counts is not None, settings.replace(treelet_tier_bytes=0))
        self._window = window
        self._progress = allocate_progress(rays.origin.size, trail_words(paged.levels), True, self._device)
        self._view = residency.view()
        self._page_of = np.asarray(paged.treelet_page)
        self._used = np.zeros(len(paged.pages), np.int64)  # window in which each page was used last
        self._windows = 0
        self._under_way: list[tuple[RayKind, np.ndarray]] = []
        self._finished: list[tuple[RayKind, RayList]] = []
        self._totals = BatchingTotals()
        self._start = time.perf_counter()

    def submit(self, kind: RayKind, rays: RayList) -> None:
        """See `Tracer.submit`."""
        slots = rays.slots.numpy()[: int(rays.count.numpy()[0])].copy()
        if len(slots):
            self._totals.rays += len(slots)
            self._under_way.append((kind, slots))

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """Finish all rays, whatever `stop` says; see `Tracer.advance`."""
        for kind, slots in self._under_way:
            for first in range(0, len(slots), self._window):
                self._trace(slots[first : first + self._window])
            count = wp.array([len(slots)], dtype=int, device=self._device)
            self._finished.append((kind, RayList(wp.array(slots, dtype=int, device=self._device), count, len(slots))))
            self._totals.finished += len(slots)
        self._under_way = []

    def take_finished(self) -> list[tuple[RayKind, RayList]]:
        """See `Tracer.take_finished`."""
        finished, self._finished = self._finished, []
        return finished

    def forget(self) -> None:
        """See `Tracer.forget`."""
        self._under_way, self._finished = [], []

    def totals(self) -> BatchingTotals:
        """Figures of the work so far."""
        totals, pages = self._totals, self._view.counts
        totals.bytes_copied, totals.pages_loaded, totals.pages_evicted = pages.bytes_copied, pages.loaded, pages.evicted
        totals.resident_peak = self._residency.bytes_peak
        totals.treelet_visits = int(self._progress.visits.numpy()[0])
        return totals

    def close(self) -> None:
        """Nobody waits here any more."""
        self._view.close()

    def _trace(self, window: np.ndarray) -> None:
        """A window, to the end of all its rays."""
        self._windows += 1
        slots, where = window.copy(), np.full(len(window), NEW, np.int32)
        seen = np.zeros(len(self._paged.pages), bool)
        while len(slots):
            where = self._go_on(slots, where, seen)
            alive = where != DONE
            slots, where = slots[alive], where[alive]
            self._totals.rays_queued += len(slots)
            if not len(slots):
                return
            wanted = self._page_of[where]
            there = self._residency.there()
            used = np.unique(wanted[there[wanted]])
            if not len(used):
                # the first in the order of rays
                self._bring(int(wanted[0]))
                seen &= self._residency.there()
                used = wanted[:1]
            seen[used] = True
            self._used[used] = self._windows

    def _go_on(self, slots: np.ndarray, where: np.ndarray, seen: np.ndarray) -> np.ndarray:
        device = self._device
        batch = RayList(
            wp.array(slots, dtype=int, device=device),
            wp.array([len(slots)], dtype=int, device=device),
            len(slots),
            wp.array(where, dtype=int, device=device),
        )
        self._view.begin(only=seen)
        with self._timer.stage("trace"):
            self._stage.launch(
                self._paged.tree, self._view.treelets, self._rays, self._progress, batch, self._any_first, self._counts
            )
        self._view.end()
        self._totals.steps += 1
        return batch.locations.numpy()

    def _bring(self, page: int) -> None:
        """Read `page` now."""

        def least_recently_used(facts: PageFacts, count: int) -> list[int]:
            pages = np.flatnonzero(facts.evictable)
            return pages[np.lexsort((pages, self._used[pages]))][: max(0, count)].tolist()

        with self._timer.stage("copy"):
            changes = self._residency.changes
            self._residency.ask(lambda facts, count: [page], least_recently_used, 1, self._view.counts)
            while not self._residency.there()[page]:
                self._residency.wait(changes, PATIENCE)
                changes = self._residency.changes
