"""Warps on a CPU: real rays in a batched trace, with the engine's own kernel of the top level, lane by lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from benchmarking.rays import CapturedRays
from benchmarking.tracers.stages import slot_list, upload_rays

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import TraceCounts, counts_of
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, TraceOptions, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import TopProgress, Tree, Treelets
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.rays import RayKind, RayList, Rays
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.buckets.tracer import BatchingTracer
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from raybatch_addon.core.wavefront.tracers.visit import VisitStage, visit_stage
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays
from studies.hardware.record import hits_of

LANES = 32


@dataclass(frozen=True)
class Counts:
    """Of a whole trace, in the top level alone but for the last two."""

    rays: int
    fetches: int  # nodes that warps read: of the lanes of a warp that visit the same in a turn, one
    visits: int  # nodes that rays visit
    turns: int  # of warps
    treelets: int  # in the tree
    treelet_visits: int
    queued: int  # times that a ray is put into a queue


class CountedTop:
    """The task TOP of warps of `LANES` lanes, and what they did in all launches; a `VisitStage`."""

    def __init__(self, top_level: TopLevelTraversal, ray_count: int):
        options = VisitOptions(task=VisitTask.TOP, instancing=False, counters=True, top_level=top_level, lanes=LANES)
        self._stage = visit_stage(Layout.QUANTISED, options)
        self.kernels, self.writes_queues = self._stage.kernels, self._stage.writes_queues
        self.counts = counts_of(ray_count, wp.get_device("cpu"), waits=True)
        self.counts.lanes = wp.zeros(7, dtype=wp.int64, device="cpu")  # with the nodes that are read

    def prepare(self, device: wp.Device) -> None:
        """See `VisitStage.prepare`."""
        self._stage.prepare(device)

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
        """See `VisitStage.launch`."""
        self._stage.launch(tree, treelets, rays, progress, batch, any_first, self.counts)


def traced(
    built: BuiltTree, rays: CapturedRays, top_level: TopLevelTraversal, selection: str, treelet_bytes: int
) -> Counts:
    """All `rays` wait at the treelets of `built`, until they are done; their hits must be those of the whole tree."""
    device, count = wp.get_device("cpu"), len(rays)
    cut = cut_scene_tree(built, CutRule(bytes_max=treelet_bytes), device)
    uploaded = upload_rays(rays, device)
    top = CountedTop(top_level, count)
    stages: dict[VisitTask, VisitStage] = {
        task: visit_stage(Layout.QUANTISED, VisitOptions(task=task, instancing=False)) for task in VisitTask
    }
    stages[VisitTask.TOP] = top
    kind = RayKind.OCCLUSION if rays.type.shadow else RayKind.CLOSEST
    path_count = 0 if rays.type.shadow else count
    worker = WorkerRays(rays=uploaded, path_count=path_count, shadow_kind=RayKind.OCCLUSION, device=device)
    settings = RenderSettings(bucket_selection=selection)
    tracer = BatchingTracer(cut, worker, settings, False, stages=stages, rays_few=0, capacity=count)
    tracer.submit(kind, slot_list(slice(0, count), device))
    finished = 0
    while finished < count:
        tracer.advance()
        finished += sum(done.bound for _, done in tracer.take_finished())
    whole = upload_rays(rays, device)
    stage = trace_stage(Layout.QUANTISED, TraceOptions(any_hit=rays.type.shadow, instancing=False))
    stage.launch(built.tree, whole, slot_list(slice(0, count), device), None)
    for mine, other in zip(hits_of(uploaded, rays.type.shadow), hits_of(whole, rays.type.shadow), strict=True):
        assert np.array_equal(mine, other), "rays that waited met something else"
    totals, lanes = tracer.totals(), top.counts.lanes.numpy()
    return Counts(
        rays=count,
        fetches=int(lanes[6]),
        visits=int(top.counts.node_steps.numpy().sum(dtype=np.int64)),
        turns=int(lanes[1]) // LANES,
        treelets=cut.treelet_count,
        treelet_visits=totals.treelet_visits,
        queued=totals.rays_queued,
    )
