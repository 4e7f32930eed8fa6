"""RayBatch in notebooks: renders, their rays in files, tracers on these rays, and studies. The docs have a
notebook that shows it all (docs/laboratory.ipynb); what is here is made of the scripts' own parts.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from benchmarking.orders import parse_orders
from benchmarking.rays import parse_ray_types
from benchmarking.scenes import SceneRequest
from benchmarking.tracers.rivals.registry import parse_rivals
from benchmarking.traces.record import RecordRequest, record_trace
from benchmarking.traversal import TraversalRequest, measure_traversal

from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core import Film, RenderSettings, Scene, Session, load_scene, save_scene
from studies.own.study import run_study
from studies.scenes import room

__all__ = ["RenderSettings", "load_scene", "measure", "record", "render", "room", "run_study", "save_scene"]


def render(scene: Scene, settings: RenderSettings, device: str = "AUTO") -> Film:
    """The film of `scene`, by a session of its own on `device` (`cpu`, `cuda:0`, AUTO: a GPU if there is one). Raises
    `RayBatchError`.
    """
    session = Session(device, settings, kernel_cache_folder())
    try:
        return session.render(scene, settings)
    finally:
        session.close()


def record(scene: Path, out: Path, kinds: str, ray_count: int, device: str = "AUTO") -> dict[str, np.ndarray]:
    """Record in `out` the rays of a render of the saved scene, `ray_count` of each of the `kinds`, such as
    `primary,bounce1,shadow1`, with what RayBatch finds that they hit; returns the arrays of the file
    (docs/ray-traces.md). Raises `RayBatchError`.
    """
    record_trace(
        RecordRequest(
            scene=SceneRequest(scene),
            out=out,
            ray_types=parse_ray_types(kinds),
            device=device,
            ray_count=ray_count,
            hits_of="off",
        )
    )
    with np.load(out) as trace:
        return dict(trace)


def measure(
    scene: Path, rays: Path, tracers: str, rivals: Sequence[str] = (), runs: int = 3, device: str = "AUTO"
) -> list[dict[str, Any]]:
    """Compare the hits of `tracers`, such as `off,reference`, and `rivals`, such as `packet:rays=64`
    (docs/experiments/rivals.md), for the recorded rays, and time them in turns, `runs` times each. Returns a row for
    each kind of rays and tracer, as `benchmark.py traversal` reports it. Raises `RayBatchError`.
    """
    asked = TraversalRequest(
        scene=SceneRequest(scene),
        device=device,
        tracers=tracers.split(","),
        rivals=parse_rivals(list(rivals)),
        ray_types=[],
        rays_file=rays,
        orders=parse_orders("natural"),
        threads=[1],
        runs=runs,
        counters=False,
    )
    return measure_traversal(asked)["results"]
