"""Tracers made of a render's own stages: RayBatch's tree without queues, and Warp's."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import seconds_of, slices
from benchmarking.tracers.fault_memory import FaultMemory
from benchmarking.tracers.interface import Hits, MeasuredTracer, Timing, Tree
from raybatch_addon.core.bvh.build.scene_tree import build_scene_tree, layout_for, splits_triangles
from raybatch_addon.core.bvh.traverse.counts import LANE_PARTS, counts_of
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.traverse.reference import build_reference
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList, Rays
from raybatch_addon.core.scene.geometry import host_array, upload_geometry
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.order.ray_sort import RaySorter, sort_kernel
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import TraceStage, trace_stage


@dataclass
class BuiltScene:
    """A scene's tree on the device."""

    tree: Any  # what kernels take
    reported: Tree
    keep: Any
    nodes: wp.array | None = None  # the tree's, in memory: what hosts read (own trees)


def with_nodes(tree: Any, nodes: wp.array, triangles: wp.array) -> Any:
    """A copy of `tree` whose nodes and triangles lie elsewhere."""
    moved = type(tree)()
    for name in tree._cls.vars:
        setattr(moved, name, getattr(tree, name))
    moved.nodes, moved.triangles = nodes, triangles
    return moved


class SceneTrees:
    """Trees by kind, each built once for all tracers that visit it."""

    def __init__(self, device: wp.Device, settings: RenderSettings, beyond: int = 0):
        """`beyond`: nodes and triangles are beyond memory, all in the host's memory, which a CUDA device reads through
        the bus, or on the CPU so many bytes of them there at a time; 0: all are in memory.
        """
        self._device, self._settings, self.beyond = device, settings, beyond
        self.faults: FaultMemory | None = None  # where nodes and triangles lie, of a CPU beyond memory
        self._built: dict[str, BuiltScene] = {}
        self.paged: Any = None  # what is kept beyond memory, shared by the tracers that bring it in

    def get(self, scene: BenchmarkScene, batching: str) -> BuiltScene:
        """The tree for the setting `batching`."""
        if batching not in self._built:
            self._built[batching] = self._reference(scene) if batching == "REFERENCE" else self._own(scene)
        return self._built[batching]

    def _own(self, scene: BenchmarkScene) -> BuiltScene:
        geometry = upload_geometry(scene.flat, scene.scene, self._device)
        splits = splits_triangles(self._settings.spatial_splits, layout_for(self._device))
        wp.synchronize_device(self._device)
        start = time.perf_counter()
        built = build_scene_tree(
            scene.flat,
            geometry,
            scene.scene.instances.visibility,
            scene.instancing,
            self._device,
            layout_for(self._device),
            splits,
        )
        wp.synchronize_device(self._device)
        reported = Tree(time.perf_counter() - start, built.statistics["bytes"])
        tree = self._moved(built.tree) if self.beyond else built.tree
        return BuiltScene(tree, reported, (built, geometry, tree), built.tree.nodes)

    def close(self) -> None:
        """Give back what lies beyond memory; nobody traces any more."""
        if self.faults:
            self.faults.close()
            self.faults = None

    def _moved(self, tree: Any) -> Any:
        if self._device.is_cuda:
            moved = [host_array(array.numpy(), array.dtype, self._device) for array in (tree.nodes, tree.triangles)]
        else:
            self.faults = FaultMemory([tree.nodes, tree.triangles], self.beyond)
            moved = self.faults.arrays
        return with_nodes(tree, *moved)

    def _reference(self, scene: BenchmarkScene) -> BuiltScene:
        wp.synchronize_device(self._device)
        used = _device_memory(self._device)
        start = time.perf_counter()
        built = build_reference(scene.flat, scene.scene.instances.visibility, scene.instancing, self._device)
        wp.synchronize_device(self._device)
        seconds = time.perf_counter() - start
        return BuiltScene(
            built.tree, Tree(seconds, _device_memory(self._device) - used if self._device.is_cuda else None), built
        )


def _device_memory(device: wp.Device) -> int:
    """Memory that Warp holds on a CUDA device [bytes]; 0 on the CPU."""
    if not device.is_cuda:
        return 0
    return int(
        wp.get_mempool_used_mem_current(device)
        if wp.is_mempool_enabled(device)
        else device.total_memory - device.free_memory
    )


@dataclass
class _Part:
    """The rays of one thread."""

    stage: TraceStage
    listed: RayList
    sorter: RaySorter | None
    in_order: RayList | None = None  # what was sorted last


class StageTracer(MeasuredTracer):
    """Every ray visits the whole tree at once, as in a render with the setting `batching` OFF or REFERENCE."""

    def __init__(
        self,
        name: str,
        trees: SceneTrees,
        device: wp.Device,
        batching: str,
        sorts: bool = False,
        plain: bool = False,
        counts: bool = False,
    ):
        """`sorts`: rays are sorted before each run. `plain`: a thread traces one ray after another, without
        refill, to compare with. `counts`: steps and tests are counted, by a run apart.
        """
        self.name = name
        self._trees, self._device, self._batching, self._sorts, self._plain = trees, device, batching, sorts, plain
        self._counts = counts and batching != "REFERENCE"
        self._layout = None if batching == "REFERENCE" else layout_for(device)

    def build(self, scene: BenchmarkScene) -> Tree:
        self._built = self._trees.get(scene, self._batching)
        self._instancing, self._box = scene.instancing, scene.box()
        kernels = [kernel for any_hit in (False, True) for kernel in self._stage(any_hit).kernels]
        if self._sorts:
            kernels.append(sort_kernel(self._device))
        load_kernels(kernels, self._device, lambda done, total: None)
        return self._built.reported

    def _stage(self, any_hit: bool, counters: bool = False) -> TraceStage:
        options = TraceOptions(any_hit=any_hit, instancing=self._instancing, counters=counters)
        return trace_stage(self._layout, replace(options, interleave=1, refill=0) if self._plain else options)

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        self._any_hit = rays.type.shadow
        self._rays = upload_rays(rays, self._device)
        self._parts = []
        for part in slices(len(rays), thread_count):
            sorter = RaySorter(part.stop - part.start, self._device, *self._box) if self._sorts else None
            self._parts.append(_Part(self._stage(self._any_hit), slot_list(part, self._device), sorter))

    def trace(self) -> Timing:
        sort_seconds, before = 0.0, self._bytes_brought()
        if self._sorts:
            sort_seconds = seconds_of([lambda part=part: self._sort(part) for part in self._parts], self._device)
        waits = self._trees.beyond > 0
        seconds = seconds_of([lambda part=part: self._launch(part) for part in self._parts], self._device, waits)
        self._brought = self._bytes_brought() - before
        return Timing(sort_seconds + seconds, sort_seconds)

    def _bytes_brought(self) -> int:
        return self._trees.faults.bytes_brought if self._trees.faults else 0

    def _sort(self, part: _Part) -> None:
        part.in_order = part.sorter.sort(self._rays, part.listed)

    def _launch(self, part: _Part) -> None:
        part.stage.launch(self._built.tree, self._rays, part.in_order or part.listed, None)

    def hits(self) -> Hits:
        return hits_of(self._rays, self._any_hit)

    def work(self) -> dict[str, Any]:
        brought = {"bytes_copied": self._brought} if self._trees.faults else {}
        if not self._counts:
            return super().work() | brought
        stage, count = self._stage(self._any_hit, counters=True), len(self._rays.t_max)
        reported = counts_of(count, self._device)
        for part in self._parts:
            stage.launch(self._built.tree, self._rays, part.in_order or part.listed, reported)
        found = {
            name: round(float(getattr(reported, name).numpy().mean()), 3)
            for name in ("node_steps", "box_tests", "triangle_tests")
        }
        lanes = reported.lanes.numpy().reshape(-1, 2)
        shares = {
            name: round(busy / there, 4)
            for name, (busy, there) in zip(LANE_PARTS, lanes.tolist(), strict=True)
            if there
        }
        return super().work() | brought | found | {"lanes_active": shares if self._device.is_cuda else None}


def hits_of(rays: Rays, any_hit: bool) -> Hits:
    """What kernels left in `rays`; of rays that ask for any hit only whether there is one."""
    hit = rays.hit_instance.numpy() >= 0
    if any_hit:
        return Hits(hit, None)
    return Hits(hit, rays.hit_t.numpy(), rays.hit_instance.numpy(), rays.hit_primitive.numpy(), rays.hit_uv.numpy())


def slot_list(part: slice, device: wp.Device) -> RayList:
    """The ray slots `part`."""
    slots = np.arange(part.start, part.stop, dtype=np.int32)
    return RayList(
        wp.array(slots, dtype=int, device=device), wp.array([len(slots)], dtype=int, device=device), len(slots)
    )


def upload_rays(rays: CapturedRays, device: wp.Device) -> Rays:
    """`rays` as kernels take them, in slots 0 to n - 1."""
    uploaded = allocate_rays(len(rays), device)
    uploaded.origin.assign(rays.origin)
    uploaded.direction.assign(rays.direction)
    uploaded.t_max.assign(rays.t_max)
    uploaded.visibility.assign(rays.visibility)
    return uploaded
