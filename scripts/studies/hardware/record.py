"""Traces of rays: the engine's own traversal of quantised trees, on the CPU, with a note of everything that it reads.

The native text of the traversal stays what it is, but for two places, of which there must be exactly one each: the
lambda through which all nodes and triangles are read also notes which one it is, and where a ray ends the end of its
notes is written. A ray is traced twice, once to count its notes and once to keep them. What rays meet must be what the
traversal without notes says.
"""

from __future__ import annotations

import functools

import numpy as np
import warp as wp
from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.tracers.stages import slot_list, upload_rays
from lib.command import UsageError

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree, splits_triangles
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import NO_COUNTS, TraceCounts
from raybatch_addon.core.bvh.traverse.cuda import trace_source
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import DeviceRayList, Rays, fill_list
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from studies.hardware.traces import NODE_WORDS, TRIANGLE_WORDS, Traces

_READ = "auto read = [](const Words* p) -> Words { return *p; };"
_NOTED_READ = """
long long noted = 0;
auto note = [&](int item) {
    if (noted < record.items.shape[0]) record.items.data[noted] = item;
    ++noted;
};
auto read = [&](const Words* p) -> Words {
    const long long n = p - (const Words*)tree.nodes.data, t = p - (const Words*)tree.triangles.data;
    if (n >= 0 && n < tree.nodes.shape[0]) {
        if (n % NODE_WORDS == 0) note((int)(n / NODE_WORDS));
    } else if (t % TRIANGLE_WORDS == 0) {
        note(~(int)(t / TRIANGLE_WORDS));
    }
    return *p;
};
"""
_END = "if (!ANY_HIT) write_hit();"
_NOTED_END = "record.end.data[slot] = noted; if (!ANY_HIT) write_hit();"


@wp.struct
class Record:
    """What the traversal notes."""

    items: wp.array(dtype=int)  # as `Traces.items`; no entries: they are counted only
    end: wp.array(dtype=wp.int64)  # by ray slot, where its items end


def recording_source(options: TraceOptions) -> str:
    """The text of the traversal that notes what it reads."""
    source = trace_source(options)
    for old, new in ((_READ, _NOTED_READ), (_END, _NOTED_END)):
        assert source.count(old) == 1, f"the traversal has not one {old}"
        source = source.replace(old, new)
    return source


@functools.cache
def recording_kernel(any_hit: bool) -> wp.Kernel:
    """Kernel (tree, rays, listed, cursor, counts, record), of one thread on the CPU."""

    @wp.func_native(recording_source(TraceOptions(any_hit=any_hit, instancing=False)))
    def trace(
        tree: Tree,
        rays: Rays,
        listed: DeviceRayList,
        cursor: wp.array(dtype=int),
        thread: int,
        counts: TraceCounts,
        record: Record,
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_recorded(
        tree: Tree, rays: Rays, listed: DeviceRayList, cursor: wp.array(dtype=int), counts: TraceCounts, record: Record
    ):
        trace(tree, rays, listed, cursor, wp.tid(), counts, record)

    return trace_recorded


def quantised_tree(scene: BenchmarkScene) -> BuiltTree:
    """The tree of `scene` in the layout of GPUs, built by the CPU's builder; raises `UsageError` where it has several
    meshes.
    """
    if scene.instancing:
        raise UsageError(f"{scene.name} has objects of their own: traces are of scenes with one tree")
    device = wp.get_device("cpu")
    return build_scene_tree(
        scene.flat,
        upload_geometry(scene.flat, scene.scene, device),
        scene.scene.instances.visibility,
        False,
        device,
        Layout.QUANTISED,
        splits_triangles(scene.settings.spatial_splits, Layout.QUANTISED),
    )


def record(built: BuiltTree, rays: CapturedRays) -> Traces:
    """What each of `rays` reads."""
    device = wp.get_device("cpu")
    uploaded = upload_rays(rays, device)
    listed = DeviceRayList()
    slots = slot_list(slice(0, len(rays)), device)
    fill_list(listed, slots)

    def traced(items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        noted = Record()
        noted.items = wp.array(items, dtype=int, device=device, copy=False)
        noted.end = wp.zeros(len(rays), dtype=wp.int64, device=device)
        uploaded.t_max.assign(rays.t_max)  # may be the memory of hits
        inputs = [built.tree, uploaded, listed, wp.zeros(1, dtype=int, device=device), NO_COUNTS, noted]
        wp.launch(recording_kernel(rays.type.shadow), 1, inputs, device=device)
        return noted.items.numpy(), noted.end.numpy().copy()

    _, end = traced(np.zeros(0, np.int32))
    items, again = traced(np.zeros(int(end[-1]), np.int32))
    assert np.array_equal(end, again), "rays read something else the second time"
    found = hits_of(uploaded, rays.type.shadow)
    uploaded.t_max.assign(rays.t_max)
    options = TraceOptions(any_hit=rays.type.shadow, instancing=False)
    trace_stage(Layout.QUANTISED, options).launch(built.tree, uploaded, slots, None)
    for mine, plain in zip(found, hits_of(uploaded, rays.type.shadow), strict=True):
        assert np.array_equal(mine, plain), "rays meet something else when they are recorded"
    return Traces(
        items=items,
        first=np.concatenate([[0], end]),
        node_count=built.tree.nodes.shape[0] // NODE_WORDS,
        triangle_count=built.tree.triangles.shape[0] // TRIANGLE_WORDS,
        origin=rays.origin,
        direction=rays.direction,
    )


def hits_of(rays: Rays, any_hit: bool) -> list[np.ndarray]:
    """What rays met, copied: whether anything; of closest hits also instance, primitive and the bits of t."""
    instance = rays.hit_instance.numpy().copy()
    if any_hit:
        return [instance >= 0]
    return [instance, rays.hit_primitive.numpy().copy(), rays.hit_t.numpy().copy().view(np.uint32)]


def launched(built: BuiltTree, rays: CapturedRays, order: np.ndarray, device: wp.Device) -> list[np.ndarray]:
    """Trace `rays` in `order` on `device` by the engine's own kernel `trace_quantised`, with a copy of the same tree,
    once: what a profiler watches there is to be compared with a simulation. Returns what `hits_of` says.
    """
    tree = Tree()
    for name, kind in Tree.vars.items():
        value = getattr(built.tree, name)
        if isinstance(kind.type, wp.array):
            value = wp.clone(value, device=device) if value is not None and value.size else value
        setattr(tree, name, value)
    taken = rays.taken(order)
    uploaded, slots = upload_rays(taken, device), slot_list(slice(0, len(taken)), device)
    options = TraceOptions(any_hit=rays.type.shadow, instancing=False)
    trace_stage(Layout.QUANTISED, options).launch(tree, uploaded, slots, None)
    wp.synchronize_device(device)
    return hits_of(uploaded, rays.type.shadow)
