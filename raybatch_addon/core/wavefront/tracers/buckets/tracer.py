"""The tracer that batches: rays wait in buckets at treelets and visit them together.

A step serves queues that the policy chooses (`policy.py`, `assigned`): rays of an entry queue visit their treelet, rays
of an exit queue go on through the top level. On the CPU, and where a step serves several buckets, the host leads from
step to step; on CUDA a captured loop does without it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import warp as wp

from ....bvh.node import Layout
from ....bvh.traverse.options import TopLevelTraversal, VisitOptions
from ....bvh.traverse.task import VisitTask
from ....bvh.treelets.tree import TreeletTree
from ....measure.batching import BatchingTotals
from ....measure.timing import NoTimer
from ....native.structs import to_numpy
from ....rays import NO_ANY_HIT, RayKind, RayList
from ....settings.settings import RenderSettings
from ...plan.launch import Launch
from ...plan.plan import has_tiers
from ...rays import trail_words
from ..visit import VisitStage, visit_stage
from ..worker_rays import WorkerRays
from .assigned.immediate import ImmediateSteps, RecentTreelets, show_kernel
from .assigned.policies import SEVERAL, assignment_of
from .assigned.prefetch import TreeletPrefetch, prefetch_kernel
from .assigned.steps import AssignedSteps, next_step_kernel
from .assigned.tiers import TierServer, bucket_large
from .assigned.within import WithinLarge
from .blocks import PLACES_MAX, STEP, pool_bytes, pool_size
from .device_loop import LOOP_KERNELS, DeviceLoop
from .finished import SPLIT_KERNELS, FinishedLists
from .policy import QueueNumbers, Selection, Step
from .policy_device import AMOUNT, BUDGET, STEP_KIND, DevicePolicy, policy_kernels
from .queues import BucketQueues, queue_kernels
from .serve import QueueRules, QueueServer
from .steps import FusedSteps, LaunchedSteps, LoopSteps, Steps, host_step_kernel
from .storage import STORAGES, InPlace, Storage

# A call of `advance` ends when this share of the rays under way is done: then new ones can be begun, and buckets stay
# full
ADVANCE_SHARE = 0.25
# With fewer rays in its fullest bucket a step costs more than it saves (some 30 microseconds on the CPU, 150 on CUDA,
# against what the rays take unbatched). A sweep serves all buckets, and costs as much whatever waits
CPU_RAYS_FEW, CPU_SWEEP_FEW = 16, 256
CUDA_RAYS_FEW, CUDA_SWEEP_FEW = 256, 1 << 16
_OCCUPANCY_STEPS = 32  # of the host between points of the occupancy


def selection_of(settings: RenderSettings) -> Selection:
    """`settings.bucket_selection`; AUTO: every bucket in each step, so that launches are large on CUDA, and rays wait
    less often on the CPU (docs/studies/schedulers.md).
    """
    if settings.bucket_selection == "AUTO":
        return Selection.ALL
    return Selection[settings.bucket_selection]


def visit_stages(
    layout: Layout,
    instancing: bool,
    counters: bool,
    settings: RenderSettings,
    curves: bool = False,
    moving: bool = False,
) -> dict[VisitTask, VisitStage]:
    """The stages that rays go through."""
    top_level, tiers = top_level_of(settings), has_tiers(settings)
    found = {"instancing": instancing, "counters": counters, "curves": curves, "motion": moving}
    options = [
        VisitOptions(task=task, top_level=top_level, tiers=tiers and task is VisitTask.TOP, **found)
        for task in VisitTask
        if not (tiers and task is VisitTask.GO_ON)
    ]
    return {each.task: visit_stage(layout, each, Launch.of(settings)) for each in options}


def batching_kernels(
    layout: Layout,
    instancing: bool,
    counters: bool,
    settings: RenderSettings,
    device: wp.Device,
    curves: bool = False,
    moving: bool = False,
) -> list[wp.Kernel]:
    """What a `BatchingTracer` launches, to be compiled ahead."""
    stages = visit_stages(layout, instancing, counters, settings, curves, moving)
    kernels = [*queue_kernels(device), *SPLIT_KERNELS]
    if host_chooses(settings):
        kernels.append(next_step_kernel)
        kernels += [show_kernel] if settings.treelet_cache else []
        kernels += [prefetch_kernel] if settings.is_on("treelet_prefetch") else []
    else:
        kernels += policy_kernels(device)
        kernels += LOOP_KERNELS if device.is_cuda else [host_step_kernel]
    kernels += storage_of(settings).kernels
    return kernels + [kernel for stage in stages.values() for kernel in stage.kernels]


def batching_bytes_per_path(
    settings: RenderSettings, shadow_rays: bool, instancing: bool, levels: int, is_cuda: bool, moving: bool = False
) -> int:
    """Device memory of a `BatchingTracer` for each path alive, but for what batches need, which is bounded [bytes]."""
    many, queues, places = 1 << 22, 512, queues_per_ray(settings)
    size = pool_size(queues, settings.queue_size, settings.queue_count, many)
    progress_bytes = 4 * trail_words(levels) + 4 * instancing
    storage = storage_of(settings)
    stored = storage.bytes_per_slot(progress_bytes, instancing, moving, size.entry_count / many)
    return math.ceil((1 + shadow_rays) * places * (stored + pool_bytes(size, queues, is_cuda) / many))


def queues_per_ray(settings: RenderSettings) -> int:
    """Treelets at which a ray waits at a time, at most. One where rays go on through treelets in a cache, treelets are
    in large ones, or SHORT_SEGMENT has rays wait behind treelets that they do not enter.
    """
    short = settings.top_level_traversal == "SHORT_SEGMENT"
    return 1 if short or settings.treelet_cache or has_tiers(settings) else settings.queues_per_ray


def copies_of(wanted: int, slot_count: int) -> int:
    """Copies of each of `slot_count` rays, `wanted` at most: their places are numbered by 31 bits."""
    return max(1, min(wanted, PLACES_MAX // (2 * max(1, slot_count))))


def storage_of(settings: RenderSettings) -> type[Storage]:
    """What holds rays in queues. Renders whose rays wait in one queue at a time do not import what copies need."""
    if queues_per_ray(settings) == 1:
        return STORAGES[settings.ray_storage]
    from .several.storage import RayCopies

    return RayCopies


def top_level_of(settings: RenderSettings) -> TopLevelTraversal:
    """How the rays of a warp go through the top level: each for itself where treelets are in large ones, in which the
    rays of a warp come from one treelet anyway.
    """
    asked = TopLevelTraversal[settings.top_level_traversal]
    return TopLevelTraversal.NAIVE if asked.elects and has_tiers(settings) else asked


def host_chooses(settings: RenderSettings) -> bool:
    """Whether the host is asked in each step which buckets are served."""
    helped = settings.treelet_cache > 0 or settings.is_on("treelet_prefetch") or has_tiers(settings)
    return helped or selection_of(settings) in SEVERAL


def processor_count(settings: RenderSettings, device: wp.Device) -> int:
    """Buckets that LAZY serves at a time."""
    return settings.bucket_processors or (device.sm_count if device.is_cuda else 1)


def few_rays(settings: RenderSettings, is_cuda: bool) -> int:
    """With fewer rays in every bucket, all go on unbatched; with fewer in all of them where one sweep serves all."""
    few, sweep_few = (CUDA_RAYS_FEW, CUDA_SWEEP_FEW) if is_cuda else (CPU_RAYS_FEW, CPU_SWEEP_FEW)
    sweeps = selection_of(settings) == Selection.ALL and not host_chooses(settings)
    return sweep_few if sweeps else few


class BatchingTracer:
    """A `Tracer` in which rays wait for others that visit the same treelet."""

    def __init__(
        self,
        treelet_tree: TreeletTree,
        worker: WorkerRays,
        settings: RenderSettings,
        instancing: bool,
        *,
        stages: Mapping[VisitTask, VisitStage] | None = None,
        rays_few: int | None = None,
        parallel: bool | None = None,
        capacity: int = 0,
        curves: bool = False,
        moving: bool = False,
    ):
        """Traces the rays of `worker` in `treelet_tree`, past segments of curves where there are `curves`, and at their
        times where things are `moving`.

        `stages`: what tracing does. `rays_few`: with fewer in every bucket, rays go on unbatched. `parallel`: the way
        of CUDA devices, on the CPU too. `capacity`: rays of a batch at most. Where these are not given they are chosen.
        """
        device, counts, debug = worker.device, worker.counts, settings.is_on("debug_checks")
        self._timer, self._numbers = worker.timer, QueueNumbers(treelet_tree.treelet_count + treelet_tree.large_count)
        self._selection = selection_of(settings)
        storage, server_type = STORAGES[settings.ray_storage], QueueServer
        queue_total, wanted = self._numbers.queue_total, queues_per_ray(settings)
        self._copies = copies_of(wanted, worker.slot_count) if wanted > 1 else 1
        slot_count = worker.slot_count * self._copies
        given: dict[str, Any] = {}
        if self._copies > 1:
            from .several.serve import SeveralServer

            storage, server_type = storage_of(settings), SeveralServer
            given = {"width": self._copies, "tree": treelet_tree.tree}
        elif has_tiers(settings):
            server_type = TierServer
        if not capacity:
            size = pool_size(queue_total, settings.queue_size, settings.queue_count, slot_count)
            capacity = storage.batch_capacity(slot_count, size.queue_size, device.is_cuda)
        self._queues = BucketQueues(
            queue_total,
            settings.queue_size,
            settings.queue_count,
            slot_count,
            device,
            debug=debug,
            capacity=capacity,
            parallel=parallel,
        )
        any_first = worker.path_count if worker.shadow_kind == RayKind.OCCLUSION else NO_ANY_HIT
        self._storage = storage(
            self._queues,
            worker.rays,
            any_first,
            trail_words(treelet_tree.levels),
            instancing=instancing,
            moving=moving,
            counts=counts,
            **given,
        )
        self._finished = FinishedLists(self._queues.capacity, worker.path_count, worker.shadow_kind, device)
        rays_few = few_rays(settings, device.is_cuda) if rays_few is None else rays_few
        is_given = stages is not None  # and so are their kernels, which are loaded already
        if stages is None:
            stages = visit_stages(treelet_tree.layout, instancing, counts is not None, settings, curves, moving)
        self._rules = QueueRules(self._numbers, stages[VisitTask.TOP].writes_queues)
        for stage in stages.values():
            stage.prepare(device)
        served = treelet_tree, stages, self._queues, self._storage, self._numbers
        self._server = server_type(*served, worker.timer)
        self._totals = BatchingTotals(block_count=self._queues.size.block_count)
        self._made_at = time.perf_counter()
        self._step = self._host_steps = self._forgotten = self._forgotten_done = 0
        self._notes, self._note_every = 0, 1
        self._steps: Steps
        if host_chooses(settings):
            asked = assignment_of(self._selection, processor_count(settings, device), settings.seed)
            if treelet_tree.large_count:
                asked = WithinLarge(asked, bucket_large(treelet_tree))
            prefetch = TreeletPrefetch(treelet_tree) if settings.is_on("treelet_prefetch") else None
            rules = {"numbers": self._numbers, "wait_max": settings.bucket_wait_max, "rays_few": rays_few}
            rules["prefetch"] = prefetch
            served_by = asked, self._queues, self._server, worker.timer
            if settings.treelet_cache:
                recent = RecentTreelets(treelet_tree.treelets, treelet_tree.treelet_bytes, settings.treelet_cache)
                self._steps = ImmediateSteps(recent, *served_by, **rules)
            else:
                self._steps = AssignedSteps(*served_by, **rules)
            return
        policy = DevicePolicy(
            self._selection,
            wait_max=settings.bucket_wait_max,
            seed=settings.seed,
            bucket_count=treelet_tree.treelet_count,
            rays_few=rays_few,
            blocks=self._queues.blocks,
            parallel=parallel,
            capacity=self._queues.capacity,
        )
        led = policy, self._server, worker.timer
        parallel_queues = self._queues.parallel_queues
        is_stepwise = self._selection != Selection.ALL and not debug and self._copies == 1
        if is_stepwise and parallel_queues and counts is None:
            untimed = QueueServer(*served, NoTimer())  # the loop is timed as one
            launched = treelet_tree.layout, instancing, False, settings, device, curves, moving
            kernels = [] if is_given else batching_kernels(*launched)
            self._steps = LoopSteps(*led, DeviceLoop(policy, parallel_queues.moves, untimed.serve_marked, kernels))
        elif is_stepwise and not parallel_queues and storage is InPlace:
            self._steps = FusedSteps(*led, self._queues, self._rules)
        else:
            self._steps = LaunchedSteps(*led)

    # --- the interface

    def submit(self, kind: RayKind, rays: RayList) -> None:
        """Rays wait to begin."""
        with self._timer.stage("queue"):
            self._storage.begin(RayList(rays.slots, rays.count, rays.bound, rays.slots), self._rules.begin)

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """See `Tracer.advance`: queues are served until a share of the rays under way is done, or none waits."""
        self._count_steps()
        waiting = self._queues.waiting
        self._note_occupancy(waiting)
        target = max(1, int(waiting * ADVANCE_SHARE / self._copies))
        self._steps.begin(target)
        while True:
            choice = self._steps.choose()
            step = choice[STEP_KIND]
            if step == Step.NOTHING:
                if choice[BUDGET] != 0:
                    return
                self._note_occupancy(self._queues.waiting)
                self._steps.begin(target)
            elif step == Step.UNBATCHED:
                self._totals.rays_unbatched += self._server.finish_all()
            elif step == Step.SWEEP:
                self._server.sweep(choice[AMOUNT])
            else:
                self._steps.serve(step, choice)
            self._host_steps += 1
            if self._host_steps % _OCCUPANCY_STEPS == 0:
                self._note_occupancy(self._queues.waiting)
            if stop and stop():
                return

    def take_finished(self) -> list[tuple[RayKind, RayList]]:
        """Rays that are done, as many as a batch may have."""
        count = int(self._queues.fetch_counts()[self._numbers.done])
        if count == 0:
            return []
        with self._timer.stage("queue"):
            taken = self._queues.take([self._numbers.done], self._rules.entry, bound=count)
            self._finished.split(self._storage.finished(taken))
        finished = self._finished.fetch()
        self._totals.finished += sum(rays.bound for _, rays in finished)
        return finished

    def forget(self) -> None:
        """See `Tracer.forget`."""
        self._forgotten += self._storage.under_way(self._queues.waiting)
        self._forgotten_done += int(self._queues.fetch_counts()[self._numbers.done])
        self._queues.clear()
        self._storage.clear()

    def release(self) -> None:
        """See `Tracer.release`."""
        self._steps.release()

    def totals(self) -> BatchingTotals:
        """What was done so far; waits for the device."""
        totals, queues = self._totals, self._queues
        for name, value in queues.totals().items():
            setattr(totals, name, value)
        totals.rays = totals.finished + self._storage.under_way(queues.waiting) + self._forgotten
        # rays that are done wait in a queue too, which is none of those that cost
        totals.rays_queued -= totals.finished + int(queues.fetch_counts()[self._numbers.done]) + self._forgotten_done
        totals.treelet_visits = int(to_numpy(self._storage.progress.visits)[0])
        self._count_steps()
        return totals.merge(BatchingTotals())

    # --- counting

    def _count_steps(self) -> None:
        """The device counts them with 32 bits, which a long render uses up."""
        step = int(self._queues.fetch_state()[STEP])
        self._totals.steps += (step - self._step) & 0xFFFFFFFF
        self._step = step

    def _note_occupancy(self, waiting: int) -> None:
        """Points are forgotten when there are many; from then on fewer are noted, so that they lie evenly."""
        self._notes += 1
        if self._notes % self._note_every == 0:
            points = len(self._totals.occupancy)
            self._totals.note_occupancy(time.perf_counter() - self._made_at, waiting)
            if len(self._totals.occupancy) < points:
                self._note_every *= 2
