"""The tracer that batches: rays wait in buckets at treelets and visit them together.

A step serves queues that the policy chooses (`bucket_policy.py`): rays of an entry queue visit their treelet, rays of an exit queue go on
through the top level. On the CPU, and for ALL, the host leads from step to step; on CUDA a captured loop does without it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import warp as wp

from ..bvh.node import Layout
from ..bvh.trace_counts import TraceCounts
from ..kernel import KERNEL_OPTIONS
from ..launches import RepeatedLaunches
from ..report.batching import BatchingTotals
from ..report.timing import NoTimer
from .batching_host import HostSteps, host_step_kernel
from .batching_loop import LOOP_KERNELS, LOOP_STEPS, DeviceLoop
from .batching_storage import STORAGE_KERNELS, VALUE_BYTES, DirectStorage
from .bucket_blocks import STEP, QueueRule, pool_bytes, pool_size
from .bucket_policy import Selection, Step
from .bucket_policy_kernel import AMOUNT, BUDGET, GO, QUEUE, STEP_KIND, DevicePolicy, policy_kernels
from .bucket_queues import BucketQueues, batch_capacity, queue_kernels, queue_rule
from .bucket_scan import Scan
from .rays import RayKind, Rays, allocate_progress, trail_words
from .stages.launch import Launch
from .stages.trace import Traversal
from .stages.visit import NO_ANY_HIT, Batch, VisitFeatures, VisitStage, VisitTask, visit_stage
from .tracer import SlotList

# A call of `advance` ends when this share of the rays under way is done: then new ones can be begun, and buckets stay full
ADVANCE_SHARE = 0.25
# With fewer rays in its fullest bucket a step costs more than it saves (some 30 microseconds on the CPU, 150 on CUDA, against what the
# rays take unbatched). A sweep serves all buckets, and costs as much whatever waits
CPU_RAYS_FEW, CPU_SWEEP_FEW = 16, 256
CUDA_RAYS_FEW, CUDA_SWEEP_FEW = 256, 1 << 16
# DIRECT: a batch's memory is twice as large as its rays
CUDA_DIRECT_BATCH = 1 << 20
_OCCUPANCY_STEPS = 32  # of the host between points of the occupancy


@wp.kernel(**KERNEL_OPTIONS)
def split_flag_kernel(slots: wp.array(dtype=int), count: wp.array(dtype=int), path_count: int, flags: wp.array(dtype=int)):
    """By ray: 1 for rays that extend paths."""
    i = wp.tid()
    flag = int(0)
    if i < count[0]:
        flag = wp.where(slots[i] < path_count, 1, 0)
    flags[i] = flag


@wp.kernel(**KERNEL_OPTIONS)
def split_kernel(
    slots: wp.array(dtype=int), count: wp.array(dtype=int), flags: wp.array(dtype=int), first: wp.array(dtype=int),
    lists: wp.array2d(dtype=int), lengths: wp.array(dtype=int), bound: int,
):  # fmt: skip
    """By ray: it goes to one of two lists; every list keeps the order."""
    i = wp.tid()
    if i < count[0]:
        if flags[i] != 0:
            lists[0, first[i]] = slots[i]
        else:
            lists[1, i - first[i]] = slots[i]
    if i == 0:
        lengths[0] = first[bound]
        lengths[1] = count[0] - first[bound]


def selection_of(settings: Any, is_cuda: bool) -> Selection:
    """`settings.bucket_selection`; AUTO: on the CPU a step is cheap, on CUDA every launch should be large."""
    if settings.bucket_selection == "AUTO":
        return Selection.ALL if is_cuda else Selection.MOST_FULL
    return Selection[settings.bucket_selection]


def visit_stages(traversal: Traversal, instancing: bool, counters: bool, settings: Any) -> dict[VisitTask, VisitStage]:
    """The stages that rays go through."""
    interlocked = settings.top_level_traversal == "INTERLOCKED"
    return {
        task: visit_stage(VisitFeatures(traversal, task, instancing, counters, interlocked and task == VisitTask.TOP), Launch.of(settings))
        for task in VisitTask
    }


def batching_kernels(layout: Layout, instancing: bool, counters: bool, settings: Any, device: wp.Device) -> list[wp.Kernel]:
    """What a `BatchingTracer` launches, to be compiled ahead."""
    stages = visit_stages(Traversal.of("OFF", layout), instancing, counters, settings)
    kernels = [*queue_kernels(device), *policy_kernels(device), *Scan.kernels, split_flag_kernel, split_kernel]
    kernels += LOOP_KERNELS if device.is_cuda else [host_step_kernel]
    if settings.ray_storage == "DIRECT":
        kernels += STORAGE_KERNELS
    return kernels + [kernel for stage in stages.values() for kernel in stage.kernels]


def batching_bytes_per_path(settings: Any, shadow_rays: bool, instancing: bool, levels: int, is_cuda: bool) -> int:
    """Device memory of a `BatchingTracer` for each path alive, but for what batches need, which is bounded [bytes]."""
    many, queues = 1 << 22, 512
    size = pool_size(queues, settings.queue_size, settings.queue_count, many)
    state = 4 * trail_words(levels) + 4 * instancing
    if settings.ray_storage == "DIRECT":
        state = (state + VALUE_BYTES + 4 * instancing) * size.place_count / many
    return math.ceil((1 + shadow_rays) * (state + pool_bytes(size, queues, is_cuda) / many))


class BatchingTracer:
    """A `Tracer` in which rays wait for others that visit the same treelet."""

    def __init__(
        self, treelet_tree: Any, rays: Rays, path_count: int, shadow_kind: RayKind, settings: Any, instancing: bool, timer: Any,
        counts: TraceCounts | None, device: wp.Device, *, stages: Mapping[VisitTask, VisitStage] | None = None,
        rays_few: int | None = None, parallel: bool | None = None, capacity: int = 0,
    ):  # fmt: skip
        """Traces `rays` in a `TreeletTree`; slots from `path_count` on are of `shadow_kind`.

        `rays_few`: with fewer in every bucket, rays go on unbatched. `parallel`: the way of CUDA devices, on the CPU too. `capacity`: rays
        of a batch at most. Where these are not given they are chosen.
        """
        slot_count = rays.origin.size
        self._tree, self._treelets, self._bucket_count = treelet_tree.tree, treelet_tree.treelets, treelet_tree.treelet_count
        self._path_count, self._shadow_kind, self._timer, self._counts = path_count, shadow_kind, timer, counts
        self._launches = RepeatedLaunches(device)
        self._stages = stages or visit_stages(Traversal.of("OFF", treelet_tree.layout), instancing, counts is not None, settings)
        for stage in self._stages.values():
            stage.prepare(device)
        self._selection = selection_of(settings, device.is_cuda)
        queue_total, debug = 2 * self._bucket_count + 2, settings.debug_checks == "ON"
        size = pool_size(queue_total, settings.queue_size, settings.queue_count, slot_count)
        direct = settings.ray_storage == "DIRECT"
        if not capacity:
            capacity = batch_capacity(slot_count, size.queue_size, device.is_cuda)
            capacity = min(capacity, max(CUDA_DIRECT_BATCH, size.queue_size)) if direct else capacity
        self._queues = BucketQueues(
            queue_total, settings.queue_size, settings.queue_count, slot_count, device, debug, capacity, parallel
        )  # fmt: skip
        done, new = queue_total - 2, queue_total - 1
        self._done, self._new = done, new
        self._entry, self._exit = queue_rule(2, 0, done, new), queue_rule(2, 1, done, new)
        self._begin = queue_rule(0, new)  # whatever stands for the place
        if rays_few is None:
            few, sweep_few = (CUDA_RAYS_FEW, CUDA_SWEEP_FEW) if device.is_cuda else (CPU_RAYS_FEW, CPU_SWEEP_FEW)
            rays_few = sweep_few if self._selection == Selection.ALL else few
        self._policy = DevicePolicy(
            self._selection, settings.bucket_wait_max, settings.seed, self._bucket_count, rays_few, self._queues.blocks, parallel,
            self._queues.capacity,
        )  # fmt: skip
        words = trail_words(treelet_tree.levels)
        any_first = path_count if shadow_kind == RayKind.OCCLUSION else NO_ANY_HIT
        self._direct = None
        if direct:
            place_count = self._queues.size.place_count
            self._direct = DirectStorage(rays, any_first, place_count, self._queues.capacity, words, instancing, counts, device)
            self._rays, self._progress, self._any_first = self._direct.rays, self._direct.progress, self._direct.any_first
            self._trace_counts = self._direct.counts
        else:
            self._rays, self._progress, self._any_first = rays, allocate_progress(slot_count, words, instancing, device), any_first
            self._trace_counts = counts
        self._scan = Scan(device)
        with wp.ScopedDevice(device):
            self._flags = wp.zeros(self._queues.capacity, dtype=int)
            self._firsts = wp.zeros(self._queues.capacity + 1, dtype=int)
            self._lists = wp.zeros((2, self._queues.capacity), dtype=int)
            self._lengths = wp.zeros(2, dtype=int)
        self._host = None
        if not self._queues.parallel_queues and self._selection != Selection.ALL and not debug and not direct:
            self._host = HostSteps(self._queues, self._policy, self._entry, self._exit)
        self._loop = None
        if self._queues.parallel_queues and self._selection != Selection.ALL and not debug and counts is None:
            kernels = batching_kernels(treelet_tree.layout, instancing, False, settings, device) if stages is None else []
            self._loop = DeviceLoop(self._policy, self._queues.parallel_queues.moves, self._serve_marked, kernels)
        self._totals = BatchingTotals(block_count=self._queues.size.block_count)
        self._made_at = time.perf_counter()
        self._step = self._host_steps = self._forgotten = self._forgotten_done = 0
        self._notes, self._note_every = 0, 1

    # --- the interface

    def submit(self, kind: RayKind, rays: SlotList) -> None:
        """Rays wait to begin."""
        batch = Batch(rays.slots, rays.slots, rays.count, rays.bound)
        with self._timer.stage("queue"):
            if not self._direct:
                self._queues.put(batch, self._begin)
                return
            for first in range(0, rays.bound, self._queues.capacity):
                part = self._queues.part(batch, first)
                self._queues.put(part, self._begin, self._direct.places)
                self._direct.store_new(part)

    def advance(self, stop: Callable[[], bool] | None = None) -> None:
        """As `Tracer.advance`: queues are served until a share of the rays under way is done, or none waits."""
        self._count_steps()
        waiting = self._queues.waiting
        self._note_occupancy(waiting)
        if self._loop and not self._loop.prepare():
            self._loop = None
        target, budget = max(1, int(waiting * ADVANCE_SHARE)), LOOP_STEPS if self._loop else -1
        self._policy.begin(target, budget)
        while True:
            choice = self._choose()
            if choice[GO]:
                self._run_loop()
                choice = self._policy.fetch()
            step = choice[STEP_KIND]
            if step == Step.NOTHING:
                if choice[BUDGET] != 0:
                    return
                self._note_occupancy(self._queues.waiting)
                self._policy.begin(target, budget)
            elif step == Step.UNBATCHED:
                self._go_on_unbatched()
            elif step == Step.SWEEP:
                self._sweep(choice[AMOUNT])
            elif self._host:
                self._trace(self._host.batch(), VisitTask.TOP if step == Step.TOP else VisitTask.TREELET)
                with self._timer.stage("queue"):
                    self._host.put(step)
            else:
                self._do_queue(step, self._take([choice[QUEUE]], choice[AMOUNT]))
            self._host_steps += 1
            if self._host_steps % _OCCUPANCY_STEPS == 0:
                self._note_occupancy(self._queues.waiting)
            if stop and stop():
                return

    def take_finished(self) -> list[tuple[RayKind, SlotList]]:
        """Rays that are done, as many as a batch may have."""
        finished = int(self._queues.fetch_counts()[self._done])
        if finished == 0:
            return []
        with self._timer.stage("queue"):
            batch = self._queues.take([self._done], self._entry, bound=finished)
            bound = batch.bound
            inputs = [batch.slots, batch.count]
            self._launches.launch(split_flag_kernel, bound, *inputs, self._path_count, self._flags)
            self._scan.launch(self._flags[:bound], self._firsts)
            self._launches.launch(split_kernel, bound, *inputs, self._flags, self._firsts, self._lists, self._lengths, bound)
        lengths = self._lengths.numpy().tolist()
        self._totals.finished += sum(lengths)
        kinds = (RayKind.CLOSEST, self._shadow_kind)
        return [
            (kind, SlotList(self._lists[k], self._lengths[k : k + 1], length))
            for k, (kind, length) in enumerate(zip(kinds, lengths)) if length
        ]  # fmt: skip

    def forget(self) -> None:
        """As `Tracer.forget`."""
        self._forgotten += self._queues.waiting
        self._forgotten_done += int(self._queues.fetch_counts()[self._done])
        self._queues.clear()

    def totals(self) -> BatchingTotals:
        """What was done so far; waits for the device."""
        totals, queues = self._totals, self._queues
        for name, value in queues.totals().items():
            setattr(totals, name, value)
        totals.rays = totals.finished + queues.waiting + self._forgotten
        # rays that are done wait in a queue too, which is none of those that cost
        totals.rays_queued -= totals.finished + int(queues.fetch_counts()[self._done]) + self._forgotten_done
        totals.treelet_visits = int(self._progress.visits.numpy()[0])
        self._count_steps()
        return totals.merge(BatchingTotals())

    # --- the steps

    def _choose(self) -> list[int]:
        """`PolicyState.choice`."""
        with self._timer.stage("queue"):
            if self._host:
                return self._host.next()
            self._policy.launch()
            return self._policy.fetch()

    def _do_queue(self, step: Step, batch: Batch) -> None:
        """Rays of an exit queue go on through the top level, those of an entry queue visit their treelet."""
        if step == Step.TOP:
            self._trace(batch, VisitTask.TOP)
            self._put(batch, self._entry)
        else:
            self._trace(batch, VisitTask.TREELET)
            self._put(batch, self._exit)

    def _serve_marked(self, step: Step, bound: int) -> None:
        """`_do_queue` for the queue that is marked on the device; no part of it is timed."""
        timer, self._timer = self._timer, NoTimer()
        try:
            self._do_queue(step, self._queues.take_marked(self._entry, bound, self._direct.places if self._direct else None))
        finally:
            self._timer = timer

    def _run_loop(self) -> None:
        """The device takes steps; they are timed as one."""
        with self._timer.stage("treelet"):
            self._loop.run()

    def _sweep(self, amount: int) -> None:
        """All entry queues, or where rays have not begun or wait behind their treelet, all exit queues."""
        if amount <= self._queues.capacity:
            # what waits in exit queues is behind its treelet: without a look at it, it waits with the others
            self._all(range(1, 2 * self._bucket_count + 2, 2), VisitTask.TOP)
            batch = self._take(range(0, 2 * self._bucket_count, 2), amount)
            self._trace(batch, VisitTask.TREELET, VisitTask.TOP)
            self._put(batch, self._entry)
            return
        self._all(range(1, 2 * self._bucket_count + 2, 2), VisitTask.TOP)
        self._all(range(0, 2 * self._bucket_count, 2), VisitTask.TREELET)

    def _go_on_unbatched(self) -> None:
        """All rays go on until they are done."""
        self._all(range(1, 2 * self._bucket_count, 2), VisitTask.TOP)
        before = self._queues.waiting - int(self._queues.fetch_counts()[self._done])
        self._all(range(self._new, self._new + 1), VisitTask.GO_ON)
        self._all(range(0, 2 * self._bucket_count, 2), VisitTask.GO_ON)
        self._totals.rays_unbatched += before

    def _all(self, queues: range, task: VisitTask) -> None:
        """Do `task` for all rays of `queues`, none of which gets rays by that."""
        left = int(self._queues.fetch_counts()[queues.start : queues.stop : queues.step].sum())
        while left > 0:
            batch = self._take(queues, left)
            self._trace(batch, task)
            self._put(batch, self._exit if task == VisitTask.TREELET else self._entry)
            left = int(self._queues.fetch_counts()[queues.start : queues.stop : queues.step].sum()) if left > batch.bound else 0

    def _take(self, queues, amount: int) -> Batch:
        with self._timer.stage("queue"):
            return self._queues.take(queues, self._entry, amount, self._direct.places if self._direct else None)

    def _trace(self, batch: Batch, *tasks: VisitTask) -> None:
        """Do `tasks`, one after another; rays that are done are passed over."""
        if self._direct:
            with self._timer.stage("queue"):
                batch = self._direct.load(batch)
        for task in tasks:
            with self._timer.stage("top level" if task == VisitTask.TOP else "treelet"):
                self._stages[task].launch(
                    self._tree, self._treelets, self._rays, self._progress, batch, self._any_first, self._trace_counts
                )  # fmt: skip

    def _put(self, batch: Batch, rule: QueueRule) -> None:
        with self._timer.stage("queue"):
            self._queues.put(batch, rule, self._direct.places if self._direct else None)
            if self._direct:
                self._direct.store(batch)

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
