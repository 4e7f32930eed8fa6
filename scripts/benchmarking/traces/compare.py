"""Checks traces, and compares the hits that another tracer wrote into one with RayBatch's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lib.command import UsageError

from benchmarking.judge import Judge
from benchmarking.progress import Steps
from benchmarking.rays import RayType
from benchmarking.scenes import SceneRequest, load_benchmark_scene
from benchmarking.traces.file import RayTrace, check_scene, read_trace, with_hits
from benchmarking.traces.record import traced, tracer_named
from benchmarking.traversal import described
from raybatch_addon.core.device.devices import device_description, find_device
from raybatch_addon.core.settings.settings import RenderSettings


def check_trace(path: Path, request: SceneRequest | None) -> dict[str, Any]:
    """What is in a trace that is as it should be, also beside its scene if that is given; raises `RayBatchError`."""
    trace = read_trace(path)
    if request is not None:
        check_scene(trace, load_benchmark_scene(request, pixel_count_of(trace)))
    rays = {}
    for each in trace.types():
        where = trace.where(each)
        rays[each.name] = {"rays": len(where)}
        if "hit" in trace.arrays:
            rays[each.name]["hits"] = int(trace.arrays["hit"][where].sum())
    return {
        "command": "check-rays",
        "file": str(path),
        "bytes": path.stat().st_size,
        "rays": rays,
        "arrays": list(trace.arrays),
        "scene": trace.header.get("scene"),
        "compared_with_scene": request is not None,
        "hits_of": (trace.header.get("hits") or {}).get("tracer"),
    }


def pixel_count_of(trace: RayTrace) -> int:
    """Pixels of the frame that the scene is opened with."""
    width, height = (trace.header.get("scene") or {}).get("frame") or (64, 64)
    return width * height


def compare_hits(
    path: Path,
    hits: Path | None,
    request: SceneRequest,
    device_name: str,
    tracer_name: str,
    types: Sequence[RayType] | None,
    ray_count: int | None,
) -> dict[str, Any]:
    """Trace the rays of `path` with RayBatch, and judge its hits and those that are stored where they differ; raises
    `RayBatchError`.
    """
    trace = read_trace(path)
    stored = with_hits(trace, hits) if hits else trace
    if "hit" not in stored.arrays:
        raise UsageError(f"{path} has no hits to compare with: give them with --hits FILE (docs/ray-traces.md)")
    device = find_device(device_name)
    scene = load_benchmark_scene(request, pixel_count_of(trace))
    check_scene(stored, scene)
    tracer = tracer_named(tracer_name, device, RenderSettings())
    captured = trace.captured(types or trace.types(), ray_count)
    theirs = [stored.hits(rays.type, ray_count) for rays in captured]
    steps = Steps(1 + len(captured))
    results, own_faults = [], 0
    try:
        steps.begin(f"building the tree of {tracer.name}")
        tracer.build(scene)
        judge = Judge(scene.flat, scene.scene.instances.visibility, device)
        steps.end()
        for rays, other in zip(captured, theirs, strict=True):
            steps.begin(f"comparing the hits of {rays.type.name}")
            mine = traced(tracer, rays)
            verdicts = judge.compare_both(rays, other, mine)
            own_faults += verdicts[1].faults
            results.append(
                {
                    "rays": rays.type.name,
                    "ray_count": len(rays),
                    "hits": int(other.hit.sum()),
                    "theirs": described(verdicts[0]),
                    "faulty_rays": trace.where(rays.type, ray_count)[list(verdicts[0].faulty)].tolist(),
                    "ours": described(verdicts[1]),
                    "same_triangle": same_triangle(mine, other),
                }
            )
            steps.end()
    finally:
        steps.close()
    return {
        "command": "compare-hits",
        "file": str(path),
        "hits_of": (stored.header.get("hits") or {}).get("tracer") or stored.name,
        "tracer": tracer.name,
        "scene": scene.name,
        "device": device_description(device),
        "results": results,
        "own_faults": own_faults,
    }


def same_triangle(mine: Any, other: Any) -> float | None:
    """Share of rays that both hit in which both name the same triangle; None where either names none."""
    both = mine.hit & other.hit
    if mine.instance is None or other.instance is None or other.primitive is None or not both.any():
        return None
    same = (mine.instance == other.instance) & (mine.primitive == other.primitive)
    return round(float(np.mean(same[both])), 6)
