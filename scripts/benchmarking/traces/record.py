"""Records a trace: the rays of a render of a scene, and what RayBatch finds that they hit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from lib.output import write_film

from benchmarking.progress import Steps
from benchmarking.rays import CapturedRays, RayType, capture_rays
from benchmarking.scenes import BenchmarkScene, SceneRequest, load_benchmark_scene
from benchmarking.tracers.interface import Hits, MeasuredTracer
from benchmarking.traces.file import ANY_HIT, CLOSEST, geometry_digest, refuse_unfit, write_trace
from raybatch_addon.core.convergence.points import scene_hash
from raybatch_addon.core.device.devices import device_description, find_device
from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.settings.settings import RenderSettings

RAY_COUNT = 100_000  # of each type, where --ray-count is not given


@dataclass(frozen=True, kw_only=True)
class RecordRequest:
    """One call of `benchmark.py record-rays`."""

    scene: SceneRequest
    out: Path
    ray_types: list[RayType]
    device: str = "AUTO"
    ray_count: int = RAY_COUNT
    hits_of: str | None = None  # name of the tracer whose hits are stored; None: none are
    triangles: Path | None = None  # where the triangles go that rays can hit, for tracers that read no scenes
    settings: dict[str, Any] = field(default_factory=dict)  # of the render


def record_trace(request: RecordRequest) -> dict[str, Any]:
    """Record, write, and report what was written; raises `RayBatchError`."""
    device = find_device(request.device)
    scene = load_benchmark_scene(request.scene, request.ray_count)
    settings = scene.settings.replace(**request.settings)
    refuse_unfit(scene)
    tracer = None if request.hits_of is None else tracer_named(request.hits_of, device, settings)
    steps = Steps(1 if tracer is None else 2)
    try:
        steps.begin(f"taking rays from a render of {scene.name}")
        captured = capture_rays(scene, settings, request.ray_types, request.ray_count, device.alias, places=True)
        steps.end()
        hits = []
        if tracer is not None:
            steps.begin(f"tracing them with {tracer.name}")
            tracer.build(scene)
            hits = [traced(tracer, rays) for rays in captured]
            steps.end()
    finally:
        steps.close()
    header = {
        "scene": {
            "name": scene.name,
            "geometry": geometry_digest(scene.scene),
            "digest": scene_hash(scene.scene),
            "triangles": scene.triangle_count,
            "frame": [scene.scene.frame.width, scene.scene.frame.height],
        },
        "rays": {rays.type.name: len(rays) for rays in captured},
        "settings": {name: getattr(settings, name) for name in ("seed", "sample_sequence", "pixel_filter")}
        | request.settings,
        "device": device_description(device),
        "versions": versions(),
        "hits": None if tracer is None else {"tracer": f"RayBatch, {tracer.name}"},
    }
    arrays = arrays_of(captured, hits)
    write_trace(request.out, header, arrays)
    if request.triangles:
        write_film(request.triangles, placed(scene))
    return {
        "command": "record-rays",
        "file": str(request.out),
        "bytes": request.out.stat().st_size,
        "triangles_file": str(request.triangles) if request.triangles else None,
        **header,
    }


def tracer_named(name: str, device: wp.Device, settings: RenderSettings) -> MeasuredTracer:
    """One of the tracers of `benchmark.py traversal`; raises `UsageError`."""
    from benchmarking.traversal import Budget, chosen_tracers, page_folder

    return chosen_tracers([name], device, settings, False, Budget(0, page_folder()), [])[0]


def traced(tracer: MeasuredTracer, rays: CapturedRays) -> Hits:
    """What `tracer`, whose tree is built, finds."""
    tracer.load(rays, 1)
    tracer.trace()
    return tracer.hits()


def arrays_of(captured: list[CapturedRays], hits: list[Hits]) -> dict[str, np.ndarray]:
    """The file's arrays, rays in the order in which they were handed over; `hits` has one for each of `captured`, or is
    empty.
    """
    columns: dict[str, list[np.ndarray]] = {}
    for number, rays in enumerate(captured):
        places, count = rays.places, len(rays)
        assert places is not None, "they were captured with their places"
        mine = {name: getattr(rays, name) for name in ("origin", "direction", "t_max")}
        mine["kind"] = np.full(count, ANY_HIT if rays.type.shadow else CLOSEST, np.uint8)
        mine["bounce"] = np.full(count, rays.type.bounce, np.uint8)
        mine["visibility"] = rays.visibility
        mine |= {name: getattr(places, name) for name in ("pixel", "sample", "wave", "sequence")}
        if hits:
            mine |= hit_columns(hits[number])
        for name, column in mine.items():
            columns.setdefault(name, []).append(column)
    # a tracer that tells no numbers tells none of any ray
    columns = {name: parts for name, parts in columns.items() if len(parts) == len(captured)}
    order = np.argsort(np.concatenate(columns["sequence"]), kind="stable")
    return {name: np.ascontiguousarray(np.concatenate(parts)[order]) for name, parts in columns.items()}


def hit_columns(hits: Hits) -> dict[str, np.ndarray]:
    """The file's arrays of hits; what is not told of any ray is left out."""
    count = len(hits.hit)
    told = hits.hit if hits.t is not None else np.zeros(count, bool)
    t = np.full(count, np.inf, np.float32) if hits.t is None else np.where(told, hits.t, np.inf).astype(np.float32)
    found = {"hit": np.asarray(hits.hit, bool), "t": t}
    if hits.t is None or hits.instance is not None:
        none = np.full(count, -1, np.int32)
        uv = np.zeros((count, 2), np.float32) if hits.uv is None else hits.uv
        for name, each in (("instance", hits.instance), ("primitive", hits.primitive)):
            found[name] = np.where(told, none if each is None else each, -1).astype(np.int32)
        for place, name in enumerate("uv"):
            found[name] = np.where(told, uv[:, place], 0).astype(np.float32)
    return found


def placed(scene: BenchmarkScene) -> dict[str, np.ndarray]:
    """All triangles that rays can hit, in their places: `v` and `f` as in files of geometry, and for each triangle its
    instance, the triangle of that instance's mesh, and the bits of rays that see it.
    """
    flat, seen = scene.flat, scene.scene.instances.visibility
    vertices, triangles = [flat.positions], []
    numbers: dict[str, list[np.ndarray]] = {"instance": [], "primitive": [], "visibility": []}

    def add(part: np.ndarray, instance: np.ndarray, primitive: np.ndarray) -> None:
        triangles.append(part)
        for name, each in (("instance", instance), ("primitive", primitive), ("visibility", seen[instance])):
            numbers[name].append(np.asarray(each, np.int32))

    sizes = np.array([len(mesh.triangles) for mesh in scene.scene.meshes])[scene.scene.instances.mesh]
    for group in flat.merged:
        local = np.arange(group.triangle_count)
        place = np.searchsorted(group.instance_triangle_first, local, side="right") - 1
        instance, primitive = group.instance[place], local - group.instance_triangle_first[place]
        there = primitive < sizes[instance]  # behind them are places of triangles that are not there
        part = flat.triangles[group.triangle_first : group.triangle_first + group.triangle_count]
        add(part[there], instance[there], primitive[there])
    first = len(flat.positions)
    for i in flat.shared.tolist():
        mesh = int(flat.instance_mesh[i])
        part = flat.triangles[flat.mesh_triangle_first[mesh] : flat.mesh_triangle_first[mesh + 1]]
        used, index = np.unique(part, return_inverse=True)
        matrix = flat.instance_transform[i].astype(np.float64)
        vertices.append((flat.positions[used] @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32))
        add((index.reshape(-1, 3) + first).astype(np.int32), np.full(len(part), i), np.arange(len(part)))
        first += len(used)
    return {
        "v": np.concatenate(vertices),
        "f": np.concatenate(triangles),
        **{name: np.concatenate(parts) for name, parts in numbers.items()},
    }
