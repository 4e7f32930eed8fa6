"""Tracers whose rays wait: batched in memory, beyond it, and the controls that they are measured against."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warp as wp
from lib.command import UsageError

from benchmarking.ray_order_paging import RayOrderPager
from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import seconds_of
from benchmarking.tracers.interface import Hits, MeasuredTracer, Timing, Tree
from benchmarking.tracers.stages import SceneTrees, StageTracer, hits_of, slot_list, upload_rays, with_nodes
from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.bvh.memory import GeometrySize
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.residency import Residency
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.device.devices import free_memory, load_kernels
from raybatch_addon.core.measure.timing import NoTimer, StageTimer, clock_of
from raybatch_addon.core.rays import RayKind
from raybatch_addon.core.scene.geometry import host_array
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Memory, Method, cut_rule, plan_tracing
from raybatch_addon.core.wavefront.scene.scene_cache import encodes
from raybatch_addon.core.wavefront.tracers.buckets.tracer import BatchingTracer, batching_kernels
from raybatch_addon.core.wavefront.tracers.interface import Tracer
from raybatch_addon.core.wavefront.tracers.pages.tracer import StreamingTracer, compiled_ahead
from raybatch_addon.core.wavefront.tracers.worker_rays import WorkerRays


class ZeroCopyTracer(StageTracer):
    """The unbatched kernel over pinned memory of the host, which a CUDA device reads through the bus."""

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, triangles_only: bool, sorts: bool = False):
        """`triangles_only`: nodes are on the device."""
        super().__init__(name, trees, device, "OFF", sorts=sorts)
        self._triangles_only = triangles_only

    def build(self, scene: BenchmarkScene) -> Tree:
        reported = super().build(scene)
        tree = self._built.tree

        def on_host(array: wp.array) -> wp.array:
            return host_array(array.numpy(), array.dtype, self._device)

        nodes = tree.nodes if self._triangles_only else on_host(tree.nodes)
        pinned = with_nodes(tree, nodes, on_host(tree.triangles))
        self._built = dataclasses.replace(self._built, tree=pinned, keep=(self._built.keep, pinned))
        return reported


@dataclass(frozen=True)
class Budget:
    """The part of the geometry that may be on the device."""

    bytes: int  # 0: all of it
    folder: Path
    nodes: bool | None = None  # whether all nodes stay on the device; None: where they fit well


class WaitingTracer(MeasuredTracer):
    """Rays wait, at treelets in memory or for pages, as in a render with the setting `batching` ON or AUTO; or, of the
    control, in turn for the pages that they want."""

    def __init__(
        self,
        name: str,
        trees: SceneTrees,
        device: wp.Device,
        settings: RenderSettings,
        budget: Budget,
        in_ray_order: bool = False,
    ):
        self.name = name
        self._trees, self._device, self._budget, self._in_ray_order = trees, device, budget, in_ray_order
        self._settings = settings.replace(batching="AUTO" if name == "auto" else "ON", geometry_budget=budget.bytes)
        self._layout = layout_for(device)
        self._tracer: Tracer | None = None

    def build(self, scene: BenchmarkScene) -> Tree:
        self._scene = scene
        size = GeometrySize.of(scene.scene)
        memory = Memory(
            size.needed(self._layout, self._device), free_memory(self._device), free_memory(wp.get_device("cpu"))
        )
        self.plan = plan_tracing(self._settings, size, self._layout, self._device.is_cuda, memory)
        if self._in_ray_order and self.plan.method is not Method.PAGED:
            raise UsageError(
                f"{self.name} pages geometry that does not fit: give --budget BYTES below what the tree needs"
            )
        settings = self._settings
        if self.plan.method is Method.PAGED:
            start = time.perf_counter()
            paged = self._paged(scene)
            reported = Tree(time.perf_counter() - start, paged.resident_bytes)
            kernels = compiled_ahead(self._layout, False, settings)
        elif self.plan.method is Method.BATCHED:
            kept = self._trees.get(scene, "OFF")
            start = time.perf_counter()
            self._treelets = cut_scene_tree(kept.keep[0], cut_rule(self.plan, self._settings), self._device)
            reported = Tree(kept.reported.build_seconds + time.perf_counter() - start, kept.reported.bytes)
            kernels = batching_kernels(self._layout, scene.instancing, False, settings, self._device)
        else:
            self._off = StageTracer(self.name, self._trees, self._device, "OFF")
            return self._off.build(scene)
        load_kernels(kernels, self._device, lambda done, total: None)
        return reported

    def _paged(self, scene: BenchmarkScene) -> Any:
        plan = self.plan
        if self._trees.paged is None:
            # pages have one budget and store: all tracers of a run share them
            self._trees.paged = build_paged_scene(
                scene.flat,
                scene.scene.instances.visibility,
                self._layout,
                self._device,
                budget=plan.geometry_budget,
                store=plan.geometry_store,
                folder=self._budget.folder,
                rule=cut_rule(self.plan, self._settings),
                nodes_resident=self._budget.nodes,
                encoded=encodes(self._layout),
            )
        self._paged_scene = found = self._trees.paged
        self._residency = Residency(found, self.plan.geometry_budget, self._device)
        return found

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        if self.plan.method is Method.UNBATCHED:
            self._off.load(rays, thread_count)
            return
        if thread_count != 1:
            raise UsageError(f"{self.name} is measured with one thread: a worker has rays and queues of its own")
        self._any_hit, self._count = rays.type.shadow, len(rays)
        self._tracer = None  # its memory, before that of the next
        self._rays = upload_rays(rays, self._device)
        self._limits = wp.clone(self._rays.t_max)
        self._listed = slot_list(slice(0, self._count), self._device)
        self._tracer = self._made(NoTimer())

    def _made(self, timer: StageTimer | NoTimer) -> Tracer:
        # rays that ask for any hit have slots of shadow rays alone
        path_count = 0 if self._any_hit else self._count
        worker = WorkerRays(
            rays=self._rays, path_count=path_count, shadow_kind=RayKind.OCCLUSION, device=self._device, timer=timer
        )
        if self.plan.method is Method.BATCHED:
            return BatchingTracer(self._treelets, worker, self._settings, self._scene.instancing)
        if self._in_ray_order:
            return RayOrderPager(self._paged_scene, self._residency, worker, self._settings)
        return StreamingTracer(self._paged_scene, self._residency, worker, self._settings)

    def trace(self) -> Timing:
        if self.plan.method is Method.UNBATCHED:
            return self._off.trace()
        wp.copy(self._rays.t_max, self._limits)  # may be where distances are written
        self._before = dataclasses.replace(self._tracer.totals())
        if self._device.is_cuda or self.plan.method is Method.PAGED:
            wp.synchronize_device(self._device)
            start = time.perf_counter()
            self._run(self._tracer)
            wp.synchronize_device(self._device)
            return Timing(time.perf_counter() - start)
        return Timing(seconds_of([lambda: self._run(self._tracer)], self._device))

    def _run(self, tracer: Tracer) -> None:
        kind = RayKind.OCCLUSION if self._any_hit else RayKind.CLOSEST
        before = tracer.totals().finished
        tracer.submit(kind, self._listed)
        while tracer.totals().finished - before < self._count:
            tracer.advance()
            tracer.take_finished()

    def hits(self) -> Hits:
        if self.plan.method is Method.UNBATCHED:
            return self._off.hits()
        return hits_of(self._rays, self._any_hit)

    def done(self) -> dict[str, Any]:
        """What the last run did where rays wait: visits to treelets and waits in queues of a ray, and pages."""
        before, after = self._before, self._tracer.totals()
        return {
            "treelet_visits": (after.treelet_visits - before.treelet_visits) / self._count,
            "queued": (after.rays_queued - before.rays_queued) / self._count,
            "bytes_copied": after.bytes_copied - before.bytes_copied,
            "pages_loaded": after.pages_loaded - before.pages_loaded,
            "resident_peak": after.resident_peak,
        }

    def work(self) -> dict[str, Any]:
        if self.plan.method is Method.UNBATCHED:
            return self._off.work()
        reported = self.done()
        timer = StageTimer(clock_of(self._device))
        self._tracer = None
        timed = self._made(timer)
        wp.copy(self._rays.t_max, self._limits)
        self._run(timed)
        stages = {f"{stage}_s": round(seconds, 6) for stage, seconds in timer.totals().items() if seconds}
        self._tracer = self._made(NoTimer())
        return super().work() | reported | {"stages": stages}
