"""Trees of one scene that must all give the same hits: built in other ways, of triangles in other orders, of other
layouts, and one that leaves out no triangle."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import slices
from benchmarking.tracers.stages import slot_list
from lib.command import UsageError

from raybatch_addon.core.bvh.build.mesh_tree import mesh_parts
from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree, layout_for, refit_scene_tree
from raybatch_addon.core.bvh.node import (
    BOXES_GROUP,
    BOXES_NODE,
    EMPTY_CHILD,
    QUANTISED_NODE,
    QUANTISED_TRIANGLE,
    Layout,
)
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.traverse.reference import build_reference
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList, Rays
from raybatch_addon.core.scene.flatten import FlatGeometry
from raybatch_addon.core.scene.geometry import Geometry
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage

TREES = {
    "sah": "built by the host, in the device's own layout",
    "splits": "the same with spatial splits",
    "shuffled": "the same over triangles in another order",
    "quantised": "built by the host, in the layout QUANTISED",
    "quantised-splits": "the same with spatial splits",
    "refitted": "built by the host for a mesh that is bent, in the device's own layout, and refitted",
    "device": "built on the device, in the layout QUANTISED",
    "device-shuffled": "the same over triangles in another order",
    "device-refitted": "the same for a mesh that is bent, and refitted",
}
TREES_DEFAULT = {
    "cpu": "sah,splits,shuffled,refitted,quantised,device",
    "cuda": "device,device-shuffled,device-refitted",
}
BENT = 0.02  # of the scene's extent: how far vertices move before a refit
FAR = 2.0**24  # boxes that are to be met by every ray reach so many times as far as the scene


def parse_trees(text: str) -> list[str]:
    """The trees of a list such as `sah,splits`; raises `UsageError`."""
    names = list(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in TREES:
            raise UsageError(f"--trees {name!r} is not known: choose of {', '.join(TREES)}")
    return names


@dataclass
class TreeTracer:
    """One tree with the stages that trace rays in it."""

    name: str
    tree: Any  # what kernels take
    layout: Layout | None  # None: Warp's tree
    instancing: bool
    keep: Any = field(repr=False, default=None)
    _stages: dict[bool, list] = field(default_factory=dict, repr=False)

    def load(self, device: wp.Device, threads: int) -> None:
        """Compile the kernels; they will run on so many threads."""
        for any_hit in (False, True):
            # a stage has state of its own
            self._stages[any_hit] = [
                trace_stage(self.layout, TraceOptions(any_hit=any_hit, instancing=self.instancing))
                for _ in range(threads)
            ]
        load_kernels(
            [kernel for stages in self._stages.values() for kernel in stages[0].kernels],
            device,
            lambda done, total: None,
        )

    def trace(self, rays: Rays, lists: list[RayList], any_hit: bool = False) -> None:
        """Trace the rays of all `lists`, each on a thread of its own."""
        stages = self._stages[any_hit]
        on_threads(
            [
                lambda stage=stage, listed=listed: stage.launch(self.tree, rays, listed, None)
                for stage, listed in zip(stages, lists)
            ]
        )


def on_threads(tasks: list[Callable[[], Any]]) -> list[Any]:
    """What `tasks` return; each has a thread."""
    if len(tasks) == 1:
        return [tasks[0]()]
    with ThreadPoolExecutor(len(tasks)) as pool:
        return list(pool.map(lambda task: task(), tasks))


def thread_count_of(device: wp.Device) -> int:
    """Threads that trace on `device`."""
    return 1 if device.is_cuda else os.cpu_count() or 1


def slot_lists(count: int, parts: int, device: wp.Device, order: np.ndarray | None = None) -> list[RayList]:
    """Slots 0 to `count` - 1, or these in another order, in `parts` lists."""
    if order is None:
        return [slot_list(part, device) for part in slices(count, parts)]
    lists = []
    for part in slices(count, parts):
        slots = order[part].astype(np.int32)
        lists.append(
            RayList(
                wp.array(slots, dtype=int, device=device), wp.array([len(slots)], dtype=int, device=device), len(slots)
            )
        )
    return lists


def build_tracer(name: str, scene: BenchmarkScene, geometry: Geometry, device: wp.Device, seed: int) -> TreeTracer:
    """The tree called `name` of `scene`, whose arrays are on `device` as `geometry`."""
    flat, visibility = scene.flat, scene.scene.instances.visibility
    layout = layout_for(device) if name in ("sah", "splits", "shuffled", "refitted") else Layout.QUANTISED
    order, there = None, geometry
    if name.endswith("shuffled"):
        order = shuffled_triangles(scene, np.random.default_rng(seed))
        flat = dataclasses.replace(flat, triangles=np.ascontiguousarray(flat.triangles[order]))
        there = trees_geometry(flat, device)
    if name.endswith("refitted"):
        flat = dataclasses.replace(flat, positions=bent(flat.positions))
        there = trees_geometry(flat, device)
    built = build_scene_tree(
        flat,
        there,
        visibility,
        scene.instancing,
        device,
        layout,
        spatial_splits=name.endswith("splits"),
        on_device=name.startswith("device"),
    )
    if name.endswith("refitted"):
        refit_scene_tree(built, scene.flat, geometry, visibility, range(len(built.meshes)), device)
    if order is not None:
        rename_faces(built, scene, order)
    return TreeTracer(name, built.tree, layout, scene.instancing, (built, there, geometry))


def trees_geometry(flat: FlatGeometry, device: wp.Device) -> Geometry:
    """The part of `flat` that trees are built of, on `device`."""
    geometry = Geometry()
    geometry.positions = wp.array(flat.positions, dtype=wp.vec3, device=device)
    geometry.triangles = wp.array(flat.triangles, dtype=wp.vec3i, device=device)
    return geometry


def bent(positions: np.ndarray) -> np.ndarray:
    """`positions` moved along slow waves."""
    low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
    extent = float((high - low).max())
    phase = 2 * np.pi * (positions - low) / (extent or 1.0)
    return (positions + BENT * extent * np.sin(3 * phase[:, [1, 2, 0]])).astype(np.float32)


def reference_tracer(scene: BenchmarkScene, device: wp.Device) -> TreeTracer:
    """Warp's tree."""
    built = build_reference(scene.flat, scene.scene.instances.visibility, scene.instancing, device)
    return TreeTracer("reference", built.tree, None, scene.instancing, built)


def whole_tracer(tracer: TreeTracer, scene: BenchmarkScene, device: wp.Device) -> TreeTracer:
    """`tracer` with boxes that every ray meets: it tests every triangle that the ray may see."""
    layout = tracer.layout
    tree = copied(tracer.tree)
    words = tracer.tree.nodes.numpy().copy()
    words = words[: len(words) - len(words) % (layout.node_words // 4)]  # there may be room behind the nodes
    if layout is Layout.BOXES:
        nodes = words.reshape(-1).view(BOXES_NODE)
        there = nodes["child"] != EMPTY_CHILD
        nodes["planes"] = np.where(
            there[:, None, None, :], np.array([-1e30, 1e30], np.float32)[:, None], nodes["planes"]
        )
    else:
        nodes = words.reshape(-1).view(QUANTISED_NODE)
        # lengths of both spaces
        reach = max(
            float(np.abs(scene.flat.positions).max()), *(abs(value) for corner in scene.box() for value in corner)
        )
        exponent = min(100, math.ceil(math.log2(reach * FAR)))
        nodes["origin"] = -(2.0**exponent)
        nodes["exponent"] = exponent - 7 + 127
        nodes["low"], nodes["high"] = 0, 255
    tree.nodes = aligned_vectors(words, device)
    return TreeTracer(f"every triangle ({tracer.name})", tree, tracer.layout, tracer.instancing, tracer)


def copied(tree: Tree) -> Tree:
    """A struct of the same arrays."""
    copy = Tree()
    for name in Tree.vars:
        setattr(copy, name, getattr(tree, name))
    return copy


def aligned_vectors(words: np.ndarray, device: wp.Device) -> wp.array:
    """The words, float32, on `device` as vectors of four; Warp's memory is aligned as trees ask."""
    return wp.array(words.reshape(-1, 4), dtype=wp.vec4, device=device)


def shuffled_triangles(scene: BenchmarkScene, generator: np.random.Generator) -> np.ndarray:
    """All triangles, those of each tree in a random order among themselves; int64, shape [triangle_count]."""
    order = np.arange(len(scene.flat.triangles))
    for part in mesh_parts(scene.flat):
        generator.shuffle(order[part.triangle_first : part.triangle_first + part.triangle_count])
    return order


def rename_faces(built: BuiltTree, scene: BenchmarkScene, order: np.ndarray) -> None:
    """Let the trees, built of triangles in `order`, call each triangle what it was called before."""
    words = built.tree.triangles.numpy().copy()
    boxes = built.layout is Layout.BOXES
    faces = words.reshape(-1).view(BOXES_GROUP if boxes else QUANTISED_TRIANGLE)["face"]
    starts = sorted(set(built.tree.entry_triangle.numpy().tolist()))
    for part, start, stop in zip(mesh_parts(scene.flat), starts, [*starts[1:], len(faces)], strict=True):
        own = faces[start:stop]
        own[own >= 0] = order[part.triangle_first + own[own >= 0]] - part.triangle_first
    built.tree.triangles = aligned_vectors(words, built.tree.triangles.device)
