"""The tracer that a render's plan asks for: what it launches, what memory it takes, and how a worker gets one."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from ..bvh.treelet_tree import TREELET_KERNELS
from ..report.counters import Counters
from ..report.timing import NoTimer, StageTimer
from ..settings import RenderSettings
from .batching import BatchingTracer, batching_bytes_per_path, batching_kernels
from .device_scene import DeviceScene
from .plan import Method
from .rays import RayKind, Rays
from .stages.launch import Launch
from .stages.trace import tracing_stages
from .streaming import StreamingTracer, compiled_ahead, streaming_bytes_per_path
from .tracer import Tracer, UnbatchedTracer
from .tracing import Tracing


def tracer_kernels(tracing: Tracing, settings: RenderSettings, shadow_rays: bool, counts: bool, device: wp.Device) -> list[wp.Kernel]:
    """What the tracer launches, for compiling ahead; `counts`: steps are counted."""
    if tracing.method is Method.BATCHED:
        cut = TREELET_KERNELS if device.is_cuda else ()
        return [*batching_kernels(tracing.layout, tracing.instancing, counts, settings, device), *cut]
    if tracing.method is Method.PAGED:
        return compiled_ahead(tracing.layout, counts, settings)
    stages = tracing_stages(tracing.traversal, tracing.instancing, counts, Launch.of(settings))
    return [kernel for kind, stage in stages.items() if shadow_rays or kind == RayKind.CLOSEST for kernel in stage.kernels]


def tracer_bytes_per_path(scene: DeviceScene, settings: RenderSettings, path_count: int) -> int:
    """Device memory that the tracer takes for each of `path_count` paths alive [bytes]."""
    if scene.treelets:
        return batching_bytes_per_path(settings, scene.shadow_rays, scene.tracing.instancing, scene.treelets.levels, scene.device.is_cuda)
    if scene.paged:
        return streaming_bytes_per_path(path_count, scene.shadow_rays, scene.paged.scene.levels)
    return 0


def make_tracer(
    scene: DeviceScene, rays: Rays, path_count: int, shadow_kind: RayKind, settings: RenderSettings, counters: Counters | None,
    timer: StageTimer | NoTimer, trace: Callable,
) -> Tracer:  # fmt: skip
    """The tracer of one worker, with slots for `path_count` paths; `trace` as for `UnbatchedTracer`."""
    tracing, counts = scene.tracing, counters.mixed if counters else None
    if scene.treelets:
        return BatchingTracer(scene.treelets, rays, path_count, shadow_kind, settings, tracing.instancing, timer, counts, scene.device)
    if scene.paged:
        return StreamingTracer(scene.paged.scene, scene.paged.residency, rays, path_count, shadow_kind, settings, timer, counts, scene.device)
    stages = tracing_stages(tracing.traversal, tracing.instancing, counts is not None, Launch.of(settings))
    return UnbatchedTracer(scene.tree, rays, stages, trace)
