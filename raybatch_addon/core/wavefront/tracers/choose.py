"""The tracer that a render's plan asks for: what it launches, what memory it takes, and how a worker gets one."""

from __future__ import annotations

import warp as wp

from ...bvh.pages.cuda.chunks import CHUNK_KERNELS
from ...bvh.pages.cuda.encode import ENCODE_KERNELS
from ...bvh.pages.divide.listed import partition_kernels
from ...bvh.treelets.tree import TREELET_KERNELS
from ...measure.counters import Counters
from ...measure.timing import NoTimer, StageTimer
from ...rays import RayKind, Rays
from ...settings.settings import RenderSettings
from ..order.ray_order import RayOrder
from ..plan.launch import Launch
from ..plan.plan import Method
from ..plan.tracing import Tracing
from ..scene.device_scene import DeviceScene
from .buckets.tracer import BatchingTracer, batching_bytes_per_path, batching_kernels
from .interface import Tracer, UnbatchedTracer
from .pages.tracer import StreamingTracer, compiled_ahead, streaming_bytes_per_path
from .unbatched import tracing_stages
from .worker_rays import WorkerRays


def tracer_kernels(
    tracing: Tracing, settings: RenderSettings, shadow_rays: bool, counts: bool, device: wp.Device
) -> list[wp.Kernel]:
    """What the tracer launches, and what makes its pages or treelets, for compiling ahead; `counts`: steps are
    counted.
    """
    if tracing.method is Method.BATCHED:
        known = tracing.layout, tracing.instancing, counts, settings, device, tracing.curves, tracing.moving
        return [*batching_kernels(*known), *TREELET_KERNELS]
    if tracing.method is Method.PAGED:
        made = (*CHUNK_KERNELS, *ENCODE_KERNELS) if device.is_cuda else ()
        launched = compiled_ahead(tracing.layout, counts, settings, tracing.curves, tracing.moving)
        return [*launched, *partition_kernels(device), *made]
    launch = Launch.of(settings)
    stages = tracing_stages(tracing.layout, tracing.instancing, counts, launch, tracing.curves, tracing.moving)
    return [
        kernel for kind, stage in stages.items() if shadow_rays or kind == RayKind.CLOSEST for kernel in stage.kernels
    ]


def tracer_bytes_per_path(scene: DeviceScene, settings: RenderSettings, path_count: int) -> int:
    """Device memory that the tracer takes for each of `path_count` paths alive [bytes]."""
    if settings.schedule == "STREAMING":
        from ..streaming.queues import stream_bytes_per_path  # other renders import none of it

        return stream_bytes_per_path(path_count, scene.shadow_rays, scene.treelets)
    if scene.treelets:
        tracing = scene.tracing
        return batching_bytes_per_path(
            settings, scene.shadow_rays, tracing.instancing, scene.treelets.levels, scene.device.is_cuda, tracing.moving
        )
    if scene.paged:
        return streaming_bytes_per_path(settings, path_count, scene.shadow_rays, scene.paged.scene.levels)
    return 0


def make_tracer(
    scene: DeviceScene,
    rays: Rays,
    path_count: int,
    shadow_kind: RayKind,
    settings: RenderSettings,
    counters: Counters | None,
    timer: StageTimer | NoTimer,
    order: RayOrder | None = None,
) -> Tracer:
    """The tracer of one worker, with slots for `path_count` paths. `order` sorts rays of tracers in which they do not
    wait; `counters` count steps.
    """
    tracing, counts = scene.tracing, counters.mixed if counters else None
    worker = WorkerRays(
        rays=rays, path_count=path_count, shadow_kind=shadow_kind, device=scene.device, timer=timer, counts=counts
    )
    met = {"curves": tracing.curves, "moving": tracing.moving}
    if scene.treelets:
        return BatchingTracer(scene.treelets, worker, settings, tracing.instancing, **met)
    if scene.paged:
        return StreamingTracer(scene.paged.scene, scene.paged.residency, worker, settings, **met)
    launch, counting = Launch.of(settings), counts is not None
    stages = tracing_stages(tracing.layout, tracing.instancing, counting, launch, tracing.curves, tracing.moving)
    work = counters.work if counters else None
    return UnbatchedTracer(scene.tree, rays, stages, order=order, timer=timer, counts=work)
