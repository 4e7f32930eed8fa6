"""The tracers that are measured. Each builds its tree, takes rays in, and traces them as often as it is told to."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.reference import build_reference
from raybatch_addon.core.device import load_kernels
from raybatch_addon.core.wavefront.rays import RayKind, Rays, allocate_rays
from raybatch_addon.core.wavefront.stages.trace import reference_kernel

from .rays import CapturedRays
from .scenes import BenchmarkScene
from .timing import seconds_of, slices


@dataclass(frozen=True)
class Tree:
    """What building cost."""

    build_seconds: float
    bytes: int | None  # nodes and geometry; None where the tracer does not tell


@dataclass(frozen=True)
class Timing:
    """One run over all rays."""

    seconds: float  # sorting included
    sort_seconds: float = 0.0


@dataclass(frozen=True)
class Hits:
    """What a tracer found."""

    hit: np.ndarray  # bool, shape [n]
    t: np.ndarray | None  # [m], float32, shape [n], where `hit`; None for occlusion rays


class MeasuredTracer(ABC):
    """One tracer under measurement."""

    name: str

    @abstractmethod
    def build(self, scene: BenchmarkScene) -> Tree:
        """Build the tree of `scene`; raises `UsageError` for a scene that this tracer cannot hold."""

    @abstractmethod
    def load(self, rays: CapturedRays, thread_count: int) -> None:
        """Take in the rays that the next runs trace, and cut them for `thread_count` threads."""

    @abstractmethod
    def trace(self) -> Timing:
        """Trace all of them."""

    @abstractmethod
    def hits(self) -> Hits:
        """What the last run found, in the order of the rays."""

    def work(self) -> dict[str, float | None]:
        """Node steps and triangle tests a ray; None where the tracer does not count."""
        return {"node_steps": None, "triangle_tests": None}


def upload_rays(rays: CapturedRays, device: wp.Device) -> Rays:
    """`rays` as kernels take them, in slots 0 to n - 1."""
    uploaded = allocate_rays(len(rays), device)
    uploaded.origin.assign(rays.origin)
    uploaded.direction.assign(rays.direction)
    uploaded.t_max.assign(rays.t_max)
    uploaded.visibility.assign(rays.visibility)
    return uploaded


def hits_of(rays: Rays, shadow: bool) -> Hits:
    """The hits in `rays`."""
    return Hits(rays.hit_instance.numpy() >= 0, None if shadow else rays.hit_t.numpy())


class ReferenceTracer(MeasuredTracer):
    """Warp's own tree."""

    name = "reference"

    def __init__(self, device: wp.Device):
        self._device = device
        self._tasks: list[Callable[[], object]] = []

    def build(self, scene: BenchmarkScene) -> Tree:
        wp.synchronize_device(self._device)
        used = device_memory(self._device)
        start = time.perf_counter()
        self._built = build_reference(scene.flat, scene.scene.instances.visibility, scene.instancing, self._device)
        wp.synchronize_device(self._device)
        seconds = time.perf_counter() - start
        grown = device_memory(self._device) - used
        self._kernels = {kind: reference_kernel(kind == RayKind.OCCLUSION, scene.instancing) for kind in (RayKind.CLOSEST, RayKind.OCCLUSION)}
        load_kernels(self._kernels.values(), self._device, lambda done, total: None)
        return Tree(seconds, grown if self._device.is_cuda else None)

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        self._shadow = rays.type.shadow
        self._rays = upload_rays(rays, self._device)
        kernel = self._kernels[RayKind.OCCLUSION if self._shadow else RayKind.CLOSEST]
        self._tasks = []
        for part in slices(len(rays), thread_count):
            slots = wp.array(np.arange(part.start, part.stop, dtype=np.int32), dtype=int, device=self._device)
            count = wp.array([len(slots)], dtype=int, device=self._device)
            inputs = [self._built.tree, self._rays, slots, count]
            self._tasks.append(lambda inputs=inputs, dim=len(slots): wp.launch(kernel, dim, inputs, device=self._device))

    def trace(self) -> Timing:
        return Timing(seconds_of(self._tasks, self._device))

    def hits(self) -> Hits:
        return hits_of(self._rays, self._shadow)


def device_memory(device: wp.Device) -> int:
    """Memory that Warp holds on a CUDA device [bytes]; 0 on the CPU."""
    if not device.is_cuda:
        return 0
    return int(wp.get_mempool_used_mem_current(device) if wp.is_mempool_enabled(device) else device.total_memory - device.free_memory)
