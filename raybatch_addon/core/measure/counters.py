"""Counters of the work that rays cause: on the device for each ray, summed by kind of ray and bounce, and for each
pixel.

Every worker has its own. What is counted on a CUDA device is summed there with integer atomics, spread over many copies
so that they seldom meet; sums do not depend on their order. A render without counters makes none of this: no arrays, no
launches, and traversals that are compiled without the lines that fill `TraceCounts`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from ..bvh.traverse.counts import LANE_PARTS, TraceCounts
from ..device.kernel import KERNEL_OPTIONS
from ..film.layout import COST_PASSES
from ..native.structs import to_numpy
from ..rays import RayList
from .hardware import UNAVAILABLE
from .timing import StageTimer, clock_of

# Numbered like `RayKind`
RAY_KINDS = ("closest", "occlusion", "transparent_shadow")
QUANTITIES = ("rays", "node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")
STEP_QUANTITIES = QUANTITIES[1:4]  # what tracers with an own tree count
BATCHING_QUANTITIES = QUANTITIES[4:]  # what tracers count that let rays wait; 0 otherwise
# Whose lanes are counted apart: kinds of rays, and launches that mix them
LANE_KINDS = (*RAY_KINDS, "mixed")
# What each of the film's `COST_PASSES` shows
COST_QUANTITIES = dict(
    zip(COST_PASSES, ("rays", "node_steps", "triangle_tests", "treelet_visits", "queued"), strict=True)
)
# Bounces that are counted apart at most; the last collects the rest
BOUNCE_BINS_MAX = 32
# Bytes of a ray that tracing reads (slot, origin, direction, t_max, visibility) and writes (t, instance, primitive,
# barycentrics; or only whether something was hit)
RAY_BYTES_READ = 4 + 12 + 12 + 4 + 4
RAY_BYTES_WRITTEN = {"closest": 20, "occlusion": 4, "transparent_shadow": 20}
_CUDA_COPIES = 256


@dataclass(frozen=True)
class CounterFeatures:
    """Features that the counters of a render are made for."""

    steps: bool  # the tracer counts what each ray did; otherwise rays alone are counted
    cost_passes: tuple[str, ...]  # of `COST_PASSES`
    batches: bool = False  # the tracer lets rays wait: visits to treelets are counted, and times queued

    @staticmethod
    def choose(
        counters: str, pass_names: tuple[str, ...], steps: bool, batches: bool = False
    ) -> CounterFeatures | None:
        """For the setting `counters` (ON or OFF) and the passes of a frame; None: nothing is counted."""
        passes = tuple(name for name in pass_names if name in COST_PASSES)
        return CounterFeatures(steps, passes, batches) if passes or counters == "ON" else None

    @property
    def by_slot(self) -> tuple[str, ...]:
        """What is counted by ray slot."""
        return STEP_QUANTITIES * self.steps + BATCHING_QUANTITIES * self.batches

    def is_filled(self, name: str) -> bool:
        """Whether the pass `name` can be other than 0."""
        return COST_QUANTITIES[name] == "rays" or COST_QUANTITIES[name] in self.by_slot

    def warnings(self) -> list[str]:
        """Which passes of the frame stay 0, and why."""
        empty = [name for name in self.cost_passes if not self.is_filled(name)]
        lines = []
        if steps := [name for name in empty if COST_QUANTITIES[name] in STEP_QUANTITIES]:
            lines.append(f"{_stay(steps)} 0: Warp's own tree does not tell its steps; set batching to AUTO, ON or OFF")
        if visits := [name for name in empty if COST_QUANTITIES[name] in BATCHING_QUANTITIES]:
            lines.append(f"{_stay(visits)} 0: in this render no ray waits at a treelet; set batching to ON to see them")
        return lines


def _stay(names: list[str]) -> str:
    return f"the passes {' and '.join(names)} stay" if len(names) > 1 else f"the pass {names[0]} stays"


@wp.struct
class CounterSums:
    """Counts of each ray, and sums over all rays so far."""

    node_steps: wp.array(dtype=int)  # by ray slot, those of its last trace; and so the next
    box_tests: wp.array(dtype=int)
    triangle_tests: wp.array(dtype=int)
    treelet_visits: wp.array(dtype=int)
    queued: wp.array(dtype=int)
    by_bounce: wp.array2d(dtype=wp.int64)  # shape [kinds * bins * quantities, copies]
    bins: int


@functools.cache
def count_kernel(features: CounterFeatures) -> wp.Kernel:
    """Kernel (sums, bounce, pixel, kind, slots, count, cost): count rays of one kind that were just finished.

    `bounce` and `pixel` are those of each path; `cost`, int64, shape [cost passes, pixels of the tile], is that of the
    tile.
    """
    steps, passes, batches = features.steps, features.cost_passes, features.batches

    @wp.kernel(**KERNEL_OPTIONS)
    def count_rays(
        sums: CounterSums,
        bounce: wp.array(dtype=int),
        pixel: wp.array(dtype=int),
        kind: int,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
        cost: wp.array2d(dtype=wp.int64),
    ):
        i = wp.tid()
        if i >= count[0]:
            return
        slot = slots[i]
        path = slot
        if path >= bounce.shape[0]:
            path = path - bounce.shape[0]  # a shadow ray
        copy = i % sums.by_bounce.shape[1]  # neighbours write side by side
        cell = (kind * sums.bins + wp.min(bounce[path], sums.bins - 1)) * wp.static(len(QUANTITIES))
        wp.atomic_add(sums.by_bounce, cell, copy, wp.int64(1))
        if wp.static(steps):
            wp.atomic_add(sums.by_bounce, cell + 1, copy, wp.int64(sums.node_steps[slot]))
            wp.atomic_add(sums.by_bounce, cell + 2, copy, wp.int64(sums.box_tests[slot]))
            wp.atomic_add(sums.by_bounce, cell + 3, copy, wp.int64(sums.triangle_tests[slot]))
        if wp.static(batches):
            wp.atomic_add(sums.by_bounce, cell + 4, copy, wp.int64(sums.treelet_visits[slot]))
            wp.atomic_add(sums.by_bounce, cell + 5, copy, wp.int64(sums.queued[slot]))
        if wp.static("Rays" in passes):
            wp.atomic_add(cost, wp.static(_row(passes, "Rays")), pixel[path], wp.int64(1))
        if wp.static(steps and "Node Steps" in passes):
            wp.atomic_add(cost, wp.static(_row(passes, "Node Steps")), pixel[path], wp.int64(sums.node_steps[slot]))
        if wp.static(steps and "Triangle Tests" in passes):
            wp.atomic_add(
                cost, wp.static(_row(passes, "Triangle Tests")), pixel[path], wp.int64(sums.triangle_tests[slot])
            )
        if wp.static(batches and "Treelet Visits" in passes):
            wp.atomic_add(
                cost, wp.static(_row(passes, "Treelet Visits")), pixel[path], wp.int64(sums.treelet_visits[slot])
            )
        if wp.static(batches and "Times Queued" in passes):
            wp.atomic_add(cost, wp.static(_row(passes, "Times Queued")), pixel[path], wp.int64(sums.queued[slot]))

    return count_rays


def _row(passes: tuple[str, ...], name: str) -> int:
    """Row of a pass among the cost passes; any where it is not asked for, because `wp.static` computes that too."""
    return passes.index(name) if name in passes else 0


@dataclass(frozen=True)
class TreeBytes:
    """Bytes that a visit reads, of the layout that is traced."""

    node: int
    triangle: int  # of one triangle test


@dataclass
class CounterTotals:
    """Counts on the host, of one worker or of several."""

    by_bounce: np.ndarray  # int64, shape [kinds, bins, quantities]
    lanes: np.ndarray  # int64, shape [len(LANE_KINDS), len(LANE_PARTS), 2]: busy lanes, all lanes
    steps: bool  # whether the tracer counted what each ray did
    seconds: dict[str, float] = field(default_factory=dict)  # by stage

    def merge(self, other: CounterTotals) -> CounterTotals:
        """The sums of both."""
        seconds = {
            stage: self.seconds.get(stage, 0.0) + other.seconds.get(stage, 0.0)
            for stage in self.seconds | other.seconds
        }
        return CounterTotals(
            self.by_bounce + other.by_bounce, self.lanes + other.lanes, self.steps and other.steps, seconds
        )

    def quantity(self, name: str) -> np.ndarray:
        """One of `QUANTITIES`, int64, shape [kinds, bins]."""
        return self.by_bounce[..., QUANTITIES.index(name)]

    def report(self, tree: TreeBytes | None, hardware: dict[str, Any] | None = None) -> dict[str, Any]:
        """For statistics (see docs/statistics.md); `tree` is None for a tracer whose nodes are not known."""
        counted = {
            name: self._by_kind(name) if self.steps or name not in STEP_QUANTITIES else UNAVAILABLE
            for name in QUANTITIES
        }
        return {
            **counted,
            "lanes_idle": {kind: self._lanes_idle(k) for k, kind in enumerate(LANE_KINDS)},
            "seconds": {stage: round(value, 6) for stage, value in self.seconds.items()},
            "bytes": self._bytes(tree),
            "hardware": hardware or {},
        }

    def _by_kind(self, name: str) -> dict[str, list[int]]:
        return dict(zip(RAY_KINDS, self.quantity(name).tolist(), strict=True))

    def _lanes_idle(self, kind: int) -> dict[str, float] | str:
        parts = {
            part: round(1.0 - busy / there, 4)
            for part, (busy, there) in zip(LANE_PARTS, self.lanes[kind].tolist(), strict=True)
            if there
        }
        return parts or UNAVAILABLE

    def _bytes(self, tree: TreeBytes | None) -> dict[str, int] | str:
        if tree is None or not self.steps:
            return UNAVAILABLE
        per_kind = np.array([RAY_BYTES_READ + RAY_BYTES_WRITTEN[kind] for kind in RAY_KINDS])
        nodes = int(self.quantity("node_steps").sum()) * tree.node
        triangles = int(self.quantity("triangle_tests").sum()) * tree.triangle
        rays = int((self.quantity("rays").sum(1) * per_kind).sum())
        return {"nodes": nodes, "triangles": triangles, "rays": rays, "total": nodes + triangles + rays}


class Counters:
    """The counters of one worker."""

    def __init__(self, features: CounterFeatures, slot_count: int, bounce_max: int, device: wp.Device):
        """For `slot_count` ray slots; extending rays come up to bounce `bounce_max` + 1."""
        self.features, self._device = features, device
        self.timer = StageTimer(clock_of(device))
        self._kernel = count_kernel(features)
        self._sums = sums = CounterSums()
        sums.bins = min(bounce_max + 2, BOUNCE_BINS_MAX)
        cells, copies = len(RAY_KINDS) * sums.bins * len(QUANTITIES), _CUDA_COPIES if device.is_cuda else 1
        sums.by_bounce = wp.zeros((cells, copies), dtype=wp.int64, device=device)
        for name in QUANTITIES[1:]:
            setattr(sums, name, wp.zeros(slot_count if name in features.by_slot else 0, dtype=int, device=device))
        self.work = [self._work() for _ in RAY_KINDS]  # what traversals fill, by kind of ray
        self.mixed = self._work()  # the same for launches that mix kinds

    def _work(self) -> TraceCounts:
        work = TraceCounts()
        for name in QUANTITIES[1:]:
            setattr(work, name, getattr(self._sums, name))
        work.lanes = wp.zeros(2 * len(LANE_PARTS), dtype=wp.int64, device=self._device)
        return work

    def begin_tile(self, pixel_count: int) -> wp.array:
        """Costs of a tile, all 0, int64, shape [cost passes, pixels]."""
        return wp.zeros((len(self.features.cost_passes), pixel_count), dtype=wp.int64, device=self._device)

    def add(self, kind: int, listed: RayList, bounce: wp.array, pixel: wp.array, cost: wp.array) -> None:
        """Count the rays of `listed`, of `RayKind` `kind`, that were just finished: each ray once.

        `bounce` and `pixel` are those of each path, `cost` comes from `begin_tile`. Shadow rays are counted at their
        path's bounce too: 1 is a shadow ray from the first surface, unless the path went straight on through it.
        """
        if listed.bound:
            inputs = [self._sums, bounce, pixel, kind, listed.slots, listed.count, cost]
            wp.launch(self._kernel, listed.bound, inputs, device=self._device)

    def totals(self) -> CounterTotals:
        """All that was counted so far; waits for the device."""
        sums = self._sums
        by_bounce = to_numpy(sums.by_bounce).sum(1).reshape(len(RAY_KINDS), sums.bins, len(QUANTITIES))
        lanes = np.stack([to_numpy(work.lanes).reshape(len(LANE_PARTS), 2) for work in (*self.work, self.mixed)])
        return CounterTotals(by_bounce, lanes, self.features.steps, self.timer.totals())


def counter_bytes_per_path(features: CounterFeatures | None, shadow_rays: bool) -> int:
    """Device memory of the counters for each path alive [bytes]; with its bounce and pixel, which they ask for."""
    return 4 * len(features.by_slot) * (1 + shadow_rays) + 8 if features else 0
