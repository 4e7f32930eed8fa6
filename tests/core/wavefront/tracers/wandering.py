"""Rays that wander among treelets at random, for tests of queues without a tree."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import Tree, Treelets
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import RayKind, RayList
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.tracers.buckets.policy import Selection
from raybatch_addon.core.wavefront.tracers.buckets.tracer import BatchingTracer
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays
from tests.support.under_test import DEVICE

SELECTIONS = tuple(Selection.__members__)
PARALLEL = (False, True) if DEVICE == "cpu" else (True,)


@wp.kernel(**KERNEL_OPTIONS)
def wander_kernel(
    slots: wp.array(dtype=int),
    where: wp.array(dtype=int),
    count: wp.array(dtype=int),
    task: int,
    treelets: int,
    visits: wp.array2d(dtype=int),
):
    """TOP (0), TREELET (1) or GO_ON (2). `visits` by slot: begun, visits, finished. The ray in slot s visits s % 7
    treelets.
    """
    i = wp.tid()
    if i >= count[0] or where[i] == -1:
        return
    slot = slots[i]
    if where[i] == -2:
        visits[0, slot] = visits[0, slot] + 1
    if task == 1 or (task == 2 and where[i] >= 0):
        visits[1, slot] = visits[1, slot] + 1
    if task == 2:
        visits[1, slot] = slot % 7
    if task != 1:
        if visits[1, slot] >= slot % 7:
            where[i] = -1
            visits[2, slot] = visits[2, slot] + 1
        else:
            mixed = wp.uint32(slot * 7 + visits[1, slot]) * wp.uint32(2654435761)
            where[i] = int((mixed >> wp.uint32(8)) % wp.uint32(treelets))


class Wander:
    """Stands for a `VisitStage`."""

    writes_queues = False

    def __init__(self, task, treelets, visits):
        self.kernels, self._task, self._treelets, self._visits = (
            (wander_kernel,),
            list(VisitTask).index(task),
            treelets,
            visits,
        )

    def prepare(self, device):
        pass

    def launch(self, tree, treelets, rays, progress, batch, any_first, counts):
        inputs = [batch.slots, batch.locations, batch.count, self._task, self._treelets, self._visits]
        wp.launch(wander_kernel, batch.bound, inputs, device=DEVICE)


@dataclass
class NoTree:
    treelet_count: int
    large_count: int = 0
    levels: int = 3
    layout: Layout = Layout.QUANTISED
    tree: Tree = dataclasses.field(default_factory=Tree)
    treelets: Treelets = dataclasses.field(default_factory=Treelets)


def wandering(treelets: int, path_count: int, parallel: bool, rays_few: int | None = 0, capacity: int = 0, **settings):
    device = wp.get_device(DEVICE)
    visits = wp.zeros((3, 2 * path_count), dtype=int, device=device)
    stages = {task: Wander(task, treelets, visits) for task in VisitTask}
    tracer = BatchingTracer(
        NoTree(treelets),
        WorkerRays(
            rays=allocate_rays(2 * path_count, device),
            path_count=path_count,
            shadow_kind=RayKind.OCCLUSION,
            device=device,
        ),
        RenderSettings(**settings),
        False,
        stages=stages,
        rays_few=rays_few,
        parallel=parallel,
        capacity=capacity,
    )
    return tracer, visits


def slot_list(slots) -> RayList:
    slots = np.asarray(slots, np.int32)
    return RayList(
        wp.array(slots, dtype=int, device=DEVICE), wp.array([len(slots)], dtype=int, device=DEVICE), len(slots)
    )


def drain(tracer) -> dict[RayKind, list[int]]:
    back = {kind: [] for kind in RayKind}
    for _ in range(10_000):
        tracer.advance()
        finished = tracer.take_finished()
        if not finished:
            return back
        for kind, listed in finished:
            back[kind] += listed.slots.numpy()[: int(listed.count.numpy()[0])].tolist()
    raise AssertionError("rays are under way without end")
