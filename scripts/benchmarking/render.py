"""Whole renders, beside Cycles when asked: at equal samples, and at equal error."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rendering.pictures import picture_path, write_picture
from rendering.request import ARCHIVE, BLEND, UsageError, kind_of
from rendering.standalone import resized

from raybatch_addon.core.device import find_device
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings import RenderSettings
from raybatch_addon.kernel_cache import kernel_cache_folder

from .progress import Steps
from .timing import spread

EPSILON = 1e-2  # of relMSE: keeps what is nearly black from counting most
ERROR_SEEDS = (1, 2)


@dataclass(frozen=True)
class RenderRequest:
    """One call of `benchmark.py render`."""

    path: Path
    device: str = "AUTO"
    samples: int = 16
    bounces: int = 7
    threads: int = 0  # 0: every core
    runs: int = 3
    size: tuple[int, int] | None = None
    against: str | None = None
    equal_error: bool = False
    picture: Path | None = None
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Opened:
    """What is rendered."""

    scene: Scene
    settings: RenderSettings
    blender_scene: Any = None  # of a .blend
    export_seconds: float | None = None


def _open(request: RenderRequest) -> _Opened:
    kind = kind_of(request.path)
    if not request.path.is_file():
        raise UsageError(f"there is no file {request.path}")
    if kind == BLEND:
        return _open_blend(request)
    if kind != ARCHIVE:
        raise UsageError(f"{request.path} cannot be measured: give a .blend, or a scene that render.py --save-scene wrote (.scene.npz)")
    scene, settings = load_scene(request.path)
    return _Opened(resized(scene, *request.size) if request.size else scene, settings.replace(device="AUTO", thread_count=0))


def _open_blend(request: RenderRequest) -> _Opened:
    try:
        import bpy
    except ImportError:
        raise UsageError(f"{request.path} needs Blender's Python module bpy, which cannot be imported here; .scene.npz does without") from None
    import raybatch_addon
    from raybatch_addon.export.scene import export_scene
    from raybatch_addon.export.settings import settings_from

    raybatch_addon.register()
    bpy.ops.wm.open_mainfile(filepath=str(request.path.resolve()))
    scene = bpy.context.scene
    if request.size:
        scene.render.resolution_x, scene.render.resolution_y = request.size
        scene.render.resolution_percentage = 100
    scene.render.engine = "RAYBATCH"
    depsgraph = bpy.context.evaluated_depsgraph_get()
    start = time.perf_counter()
    exported = export_scene(depsgraph)
    seconds = time.perf_counter() - start
    return _Opened(exported, settings_from(scene).replace(device="AUTO", thread_count=0), scene, seconds)


def measure_render(request: RenderRequest) -> dict[str, Any]:
    """The report of `benchmark.py render`; raises `RayBatchError`."""
    if request.equal_error and not request.against:
        raise UsageError("--equal-error compares two engines: give --against cycles too")
    if request.against and kind_of(request.path) != BLEND:
        raise UsageError(f"--against cycles needs a .blend, not {request.path.name}")
    picture = picture_path(request.picture.absolute()) if request.picture else None
    opened = _open(request)
    settings = opened.settings.replace(sample_count=request.samples, bounce_max=request.bounces, thread_count=request.threads)
    settings = settings.replace(**request.settings)
    device = find_device(request.device)
    session = Session(device.alias, settings, kernel_cache_folder())
    cycles = None
    if request.against:
        from .cycles import CyclesPeer

        cycles = CyclesPeer(opened.blender_scene, device, settings, settings.thread_count)
    steps = Steps(1 + request.runs + request.equal_error)
    try:
        steps.begin("first render, with compilation")
        cold = timed_render(session, opened.scene, settings)
        steps.end()
        runs, cycles_runs = [], []
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            runs.append(timed_render(session, opened.scene, settings))
            if cycles:
                cycles_runs.append(cycles.render())
            steps.end()
        report = _report(request, opened, cold, runs)
        if cycles:
            ratios = [run.seconds / other for run, other in zip(runs, cycles_runs, strict=True)]
            report |= {"cycles": summary(cycles_runs) | {"device": cycles.device}, "raybatch_over_cycles": round(statistics.median(ratios), 3)}
        if request.equal_error:
            steps.begin("renders with other seeds, for the error")
            ours = [_combined(session.render(opened.scene, settings.replace(seed=seed))) for seed in ERROR_SEEDS]
            theirs = [cycles.picture(seed) for seed in ERROR_SEEDS]
            report["equal_error"] = equal_error(report["raybatch"]["seconds"], ours, report["cycles"]["seconds"], theirs)
            steps.end()
        if picture:
            write_picture(picture, cold.film)
    finally:
        steps.close()
        session.close()
    return report


@dataclass(frozen=True)
class TimedRender:
    """One whole render."""

    seconds: float
    film: Film


def timed_render(session: Session, scene: Scene, settings: RenderSettings) -> TimedRender:
    """One whole render, tree included: caches of geometry are given back first."""
    session.close()
    start = time.perf_counter()
    film = session.render(scene, settings)
    return TimedRender(time.perf_counter() - start, film)


def summary(seconds: list[float]) -> dict[str, Any]:
    """Median and spread of several runs."""
    return {"seconds": round(statistics.median(seconds), 4), "spread": round(spread(seconds), 3), "runs": len(seconds)}


def _report(request: RenderRequest, opened: _Opened, cold: TimedRender, runs: list[TimedRender]) -> dict[str, Any]:
    told = runs[-1].film.statistics
    stages = {stage: summary([run.film.statistics["seconds"][stage] for run in runs]) for stage in ("build", "render")}
    return {
        "scene": request.path.name,
        "device": told["device"],
        "versions": told["versions"],
        "settings": told["settings"],
        "frame": told["frame"],
        "triangles": told["triangles"],
        "samples_per_pixel": told["settings"]["sample_count"],
        "bounces": told["settings"]["bounce_max"],
        "rays": told["rays"],
        "invalid_samples": told["invalid_samples"],
        "export_s": None if opened.export_seconds is None else round(opened.export_seconds, 4),
        "cold": {"seconds": round(cold.seconds, 3), "stages": cold.film.statistics["seconds"]},
        "raybatch": summary([run.seconds for run in runs]) | stages,
    }


def _combined(film: Film) -> np.ndarray:
    return film.passes["Combined"][..., :3].astype(np.float64)


def equal_error(our_seconds: float, ours: list[np.ndarray], their_seconds: float, theirs: list[np.ndarray]) -> dict[str, Any]:
    """Compare two unbiased engines by the time that each needs for the same error.

    `ours` and `theirs` are two independent pictures each, float64 [height, width, 3], which took `our_seconds` and
    `their_seconds` apiece. The noise of a picture is half the mean squared difference of the two, each pixel's divided by its
    squared brightness (relMSE); the brightness is that of all four, so that both engines are divided by the same.
    Time and error are taken as inversely proportional, so time x relMSE is what is compared.
    """
    square = (sum([*ours, *theirs]) / (len(ours) + len(theirs))) ** 2 + EPSILON
    errors = [float((((a - b) ** 2 / 2) / square).mean()) for a, b in (ours, theirs)]
    means = [float(np.mean(pictures)) for pictures in (ours, theirs)]
    costs = [our_seconds * errors[0], their_seconds * errors[1]]
    return {
        "relmse": {"raybatch": errors[0], "cycles": errors[1]},
        "efficiency": {"raybatch": _quotient(1, costs[0]), "cycles": _quotient(1, costs[1])},
        "raybatch_seconds_to_cycles_error": _quotient(costs[0], errors[1]),
        "raybatch_over_cycles": _quotient(costs[0], costs[1]),
        "mean_ratio": _quotient(means[0], means[1]),  # of the pictures' brightness: 1 where both render the same
    }


def _quotient(a: float, b: float) -> float | None:
    return float(f"{a / b:.6g}") if b else None
