"""Rendering and tracing for cases: one device, one session that is kept, and either tracer."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.memory import GeometrySize
from raybatch_addon.core.device.devices import free_memory, load_kernels
from raybatch_addon.core.film import Film
from raybatch_addon.core.measure.timing import NoTimer
from raybatch_addon.core.rays import RayKind, RayList, Rays
from raybatch_addon.core.scene.description import Scene, Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.validate import checked_scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.plan.plan import Memory, plan_tracing
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from raybatch_addon.core.wavefront.scene.geometry_request import GeometryRequest
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache
from raybatch_addon.core.wavefront.tracers.buckets import tracer as batching
from raybatch_addon.core.wavefront.tracers.choose import make_tracer, tracer_kernels
from raybatch_addon.core.wavefront.tracers.interface import Tracer

SETTINGS = RenderSettings(sample_count=16, sample_sequence="INDEPENDENT")
# Treelets of a few nodes, so that rays of small scenes visit many of them
WAITING: dict[str, Any] = dict(batching="ON", treelet_bytes=4096, treelet_size_min=1)
_FEW = ("CPU_RAYS_FEW", "CPU_SWEEP_FEW", "CUDA_RAYS_FEW", "CUDA_SWEEP_FEW")


@dataclass(frozen=True)
class Hits:
    """Hits of rays, one entry for each ray."""

    t: np.ndarray  # distance in lengths of the direction; the ray's limit if it hit nothing. float32
    instance: np.ndarray  # -1: nothing was hit; for any hit only the sign counts. int32
    primitive: np.ndarray  # triangle of the instance's mesh; int32
    uv: np.ndarray  # barycentric weights of the second and third corner; float32, shape [n, 2]

    @property
    def hit(self) -> np.ndarray:
        """Whether each ray hit anything."""
        return self.instance >= 0


class Bench:
    """A device and a tracer on it."""

    def __init__(self, device: str, tracer: str, session: Session | None = None, leak_rays: int = 0):
        """Create a bench for `device`.

        Args:
            tracer: `off` (the control), `on` (rays wait), or `-` where it does not matter (then the control).
            session: a session shared with others; by default one of its own.
            leak_rays: how many rays each case of leaks traces; 0: its own choice.
        """
        self.device, self.tracer, self.leak_rays = device, tracer, leak_rays
        self.session = session or Session(device)
        self.invalid_samples = 0  # invalid samples of all films since this was set to 0
        self.samples = 0  # samples of all films since this was set to 0

    @property
    def wp_device(self) -> wp.Device:
        """The device as Warp knows it."""
        return self.session.device

    @property
    def batching(self) -> dict[str, Any]:
        """The schedule settings of the tracer."""
        return dict(WAITING) if self.tracer == "on" else dict(batching="OFF")

    def film(self, scene: Scene, settings: RenderSettings | None = None, **change: Any) -> Film:
        """Render `scene`; `change` replaces single `settings` (default: `SETTINGS`), the tracer's included.

        Invalid samples are counted.
        """
        settings = (settings or SETTINGS).replace(**(self.batching | change))
        with rays_wait():
            film = self.session.render(scene, settings)
        self.invalid_samples += int(film.statistics["invalid_samples"])
        self.samples += int(np.sum(film.counts))
        return film

    def render(self, scene: Scene, settings: RenderSettings | None = None, **change: Any) -> np.ndarray:
        """The picture as by `film`: linear RGB, float64 [height, width, 3], bottom row first."""
        return self.film(scene, settings, **change).passes["Combined"][..., :3].astype(np.float64)

    def render_seeds(
        self, scene: Scene, seeds: int = 8, settings: RenderSettings | None = None, **change: Any
    ) -> np.ndarray:
        """Pictures of several seeds, float64 [seeds, height, width, 3].

        Their means give the statistical error without assumptions.
        """
        return np.stack([self.render(scene, settings, **change, seed=seed) for seed in range(seeds)])

    def trace(
        self,
        scene: Scene,
        origin: np.ndarray,
        direction: np.ndarray,
        t_max: float | np.ndarray = np.inf,
        any_hit: bool = False,
        visibility: int = int(Visibility.CAMERA),
    ) -> Hits:
        """Trace rays (float32, shape [n, 3] each) through the integrator's interface.

        For many rays in one scene keep a `tracer_of`.
        """
        return self.tracer_of(scene, len(origin)).trace(origin, direction, t_max, any_hit, visibility)

    def tracer_of(self, scene: Scene, ray_count: int = 1 << 18) -> SceneTracer:
        """A tracer of `scene` that takes `ray_count` rays at a time."""
        return SceneTracer(self, scene, ray_count)


@contextlib.contextmanager
def rays_wait() -> Iterator[None]:
    """Context in which rays of the batching tracer wait however few they are.

    Elsewhere few rays go on unbatched, and most of a small film's rays are few.
    """
    kept = {name: getattr(batching, name) for name in _FEW}
    try:
        for name in kept:
            setattr(batching, name, 0)
        yield
    finally:
        for name, value in kept.items():
            setattr(batching, name, value)


@dataclass
class _Part:
    """The rays of one thread, and a tracer of either kind of rays."""

    rays: Rays
    tracers: dict[bool, Tracer]  # by whether the tracer looks for any hit


class SceneTracer:
    """A scene as renders build it, and tracers as renders make them, one for each thread of the CPU."""

    def __init__(self, bench: Bench, scene: Scene, ray_count: int):
        self._device = device = bench.wp_device
        settings = SETTINGS.replace(**bench.batching)
        scene = checked_scene(scene)
        features = derive_features(scene, settings)
        size, layout = GeometrySize.of(scene), bench.session.layout
        memory = Memory(size.needed(layout, device), free_memory(device), free_memory(wp.get_device("cpu")))
        plan = plan_tracing(settings, size, layout, device.is_cuda, memory)
        request = GeometryRequest(
            settings=settings,
            plan=plan,
            layout=layout,
            instancing=features.instancing,
            page_folder=Path(tempfile.gettempdir()),
        )
        # `scene.data.geometry`: arrays for kernels
        self.scene = DeviceScene.build(scene, features, request, device, SceneCache())
        tracing = self.scene.tracing
        load_kernels(tracer_kernels(tracing, settings, True, False, device), device, lambda done, total: None)
        threads = 1 if device.is_cuda else min(os.cpu_count() or 1, max(1, ray_count // 4096))
        self._part_rays = -(-ray_count // threads)
        self._parts = []
        with rays_wait():
            for _ in range(threads):
                rays = allocate_rays(self._part_rays, device)
                # the tracer for any hit takes shadow rays in all slots
                tracers = {
                    any_hit: make_tracer(
                        self.scene,
                        rays,
                        0 if any_hit else self._part_rays,
                        RayKind.OCCLUSION,
                        settings,
                        None,
                        NoTimer(),
                    )
                    for any_hit in (False, True)
                }
                self._parts.append(_Part(rays, tracers))
        self._slots = wp.array(np.arange(self._part_rays, dtype=np.int32), dtype=int, device=device)

    def run(
        self,
        count: int,
        fill: Callable[[Rays, int, int], Any],
        any_hit: bool = False,
        done: Callable[[Rays, int, int], Any] | None = None,
    ) -> None:
        """Trace `count` rays, any number of them.

        `fill(rays, first, n)` writes rays `first` to `first + n` of the run to slots 0 to n (origin, direction, t_max,
        visibility); `done(rays, first, n)` reads their hits. Both may run on several threads at once.
        """
        starts = range(0, count, self._part_rays)

        def work(number: int) -> None:
            part = self._parts[number]
            for first in starts[number :: len(self._parts)]:
                n = min(self._part_rays, count - first)
                fill(part.rays, first, n)
                self._trace(part.tracers[any_hit], RayKind.OCCLUSION if any_hit else RayKind.CLOSEST, n)
                if done:
                    done(part.rays, first, n)

        if len(self._parts) == 1:
            work(0)
        else:
            with ThreadPoolExecutor(len(self._parts)) as pool:
                list(pool.map(work, range(len(self._parts))))

    def _trace(self, tracer: Tracer, kind: RayKind, count: int) -> None:
        tracer.submit(kind, RayList(self._slots, wp.array([count], dtype=int, device=self._device), count))
        # a list that comes back holds slots of both kinds of rays; its length is on the device
        left = count
        while left:
            tracer.advance()
            left -= sum(int(listed.count.numpy()[0]) for _, listed in tracer.take_finished() if listed.bound)

    def trace(
        self,
        origin: np.ndarray,
        direction: np.ndarray,
        t_max: float | np.ndarray = np.inf,
        any_hit: bool = False,
        visibility: int = int(Visibility.CAMERA),
    ) -> Hits:
        """Trace rays as `Bench.trace` does."""
        count = len(origin)
        origin, direction = (np.ascontiguousarray(a, np.float32).reshape(count, 3) for a in (origin, direction))
        limits = np.broadcast_to(np.asarray(t_max, np.float32), count)
        found = Hits(
            np.empty(count, np.float32),
            np.empty(count, np.int32),
            np.empty(count, np.int32),
            np.empty((count, 2), np.float32),
        )

        def fill(rays: Rays, first: int, n: int) -> None:
            part = slice(first, first + n)
            rays.origin[:n].assign(origin[part])
            rays.direction[:n].assign(direction[part])
            rays.t_max[:n].assign(np.ascontiguousarray(limits[part]))
            rays.visibility[:n].fill_(visibility)

        def done(rays: Rays, first: int, n: int) -> None:
            part = slice(first, first + n)
            found.t[part] = rays.hit_t.numpy()[:n]
            found.instance[part] = rays.hit_instance.numpy()[:n]
            if not any_hit:
                found.primitive[part] = rays.hit_primitive.numpy()[:n]
                found.uv[part] = rays.hit_uv.numpy()[:n]

        self.run(count, fill, any_hit, done)
        return found
