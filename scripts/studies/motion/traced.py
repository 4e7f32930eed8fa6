"""Rays through the trees of a scene, whole, on one device: what they meet, and what that takes."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.scene_tree import BuiltTree, build_scene_tree, layout_for
from raybatch_addon.core.bvh.traverse.counts import counts_of
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList
from raybatch_addon.core.scene.description import Scene, Visibility
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import upload_geometry
from raybatch_addon.core.scene.moved import with_motion
from raybatch_addon.core.wavefront.rays import RayNeeds, allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from studies.motion.moving import AimedRays


@dataclass
class Traced:
    """What rays met, and the sums of what that took."""

    t: np.ndarray
    nodes: int
    triangles: int
    seconds: float  # the least of some runs


def built_tree(scene: Scene, device: wp.Device, range_count: int | None = None) -> BuiltTree:
    """The trees of `scene`, in so many ranges of time; None: as many as pay."""
    flat = flatten(scene)
    geometry = upload_geometry(with_motion(flat), scene, device)
    return build_scene_tree(
        flat, geometry, scene.instances.visibility, True, device, layout_for(device), range_count=range_count
    )


def trace(built: BuiltTree, aimed: AimedRays, device: wp.Device, runs: int = 3) -> Traced:
    """Closest hits of `aimed`."""
    count = len(aimed.time)
    rays = allocate_rays(count, device, RayNeeds(time=True))
    for name in ("origin", "direction", "time"):
        getattr(rays, name).assign(getattr(aimed, name))
    listed = RayList(
        wp.array(np.arange(count), dtype=int, device=device), wp.array([count], dtype=int, device=device), count
    )
    counts = counts_of(count, device)
    rays.visibility.fill_(int(Visibility.ALL))

    def run(counted: bool) -> float:
        rays.t_max.fill_(np.inf)
        options = TraceOptions(any_hit=False, instancing=True, motion=True, counters=counted)
        stage = trace_stage(built.layout, options)
        load_kernels(list(stage.kernels), device, lambda *_: None)
        wp.synchronize_device(device)
        start = time.process_time() if device.is_cpu else time.perf_counter()
        stage.launch(built.tree, rays, listed, counts if counted else None)
        wp.synchronize_device(device)
        return (time.process_time() if device.is_cpu else time.perf_counter()) - start

    run(True)
    return Traced(
        t=rays.hit_t.numpy().copy(),
        nodes=int(counts.node_steps.numpy().sum()),
        triangles=int(counts.triangle_tests.numpy().sum()),
        seconds=min(run(False) for _ in range(runs)) if runs else 0.0,
    )
