"""Whole renders, beside Cycles when asked: at equal samples, and at equal error. RayBatch is compared with itself in
`against/`.
"""

from __future__ import annotations

import statistics
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from lib.command import UsageError
from rendering.pictures import picture_path, write_picture
from rendering.request import BLEND, kind_of

from benchmarking.against.devices import measure_against_devices
from benchmarking.against.memory import measure_against_memory, parse_budgets
from benchmarking.progress import Steps
from benchmarking.slopes import SEEDS, combined, has_ray_tracing_cores, measure_slopes, quotient, relmse_of_pairs
from benchmarking.timing import summary
from benchmarking.whole_render import OpenedScene, RenderRequest, TimedRender, open_scene, scene_report, timed_render
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings

COUNTS_ON_A_GPU = (64, 256)  # samples that tell what an engine takes once from what it takes for each of them


def with_counts(request: RenderRequest, device: wp.Device) -> RenderRequest:
    """`request` with the sample counts that suit it, where none were given: on a GPU an engine may load kernels for
    longer than it samples, which one count cannot tell.
    """
    alone = request.samples_given or request.against != "cycles" or request.equal_error
    if alone or not device.is_cuda:
        return request
    return replace(request, samples=COUNTS_ON_A_GPU[0], samples_longer=COUNTS_ON_A_GPU[1])


def measured_settings(settings: RenderSettings, request: RenderRequest) -> RenderSettings:
    """The scene's `settings` as `request` changes them; what it sets by name comes last."""
    settings = settings.replace(sample_count=request.samples, bounce_max=request.bounces, thread_count=request.threads)
    if request.equal_error or request.samples_longer:  # an unbiased peer is met without what a file may clamp
        settings = settings.replace(clamp_direct=0.0, clamp_indirect=0.0)
    return settings.replace(**request.settings)


def measure_render(request: RenderRequest) -> dict[str, Any]:
    """The report of `benchmark.py render`; raises `RayBatchError`."""
    _check_combination(request)
    budgets = parse_budgets(request.budgets) if request.budgets else []
    picture = picture_path(request.picture.absolute()) if request.picture else None
    opened = open_scene(request)
    if request.against == "devices":
        report, film = measure_against_devices(opened, measured_settings(opened.settings, request), request)
        if picture:
            write_picture(picture, film, opened.scene)
        return report
    device = find_device(request.device)
    request = with_counts(request, device)
    settings = measured_settings(opened.settings, request)
    session = Session(device.alias, settings, kernel_cache_folder())
    if request.against == "memory" or request.samples_longer:
        try:
            if request.against == "memory":
                report, film = measure_against_memory(session, opened, settings, request, budgets)
            else:
                report, film = measure_slopes(session, opened, settings, request, device)
            if picture:
                write_picture(picture, film, opened.scene)
        finally:
            session.close()
        return report
    cycles = None
    if request.against == "cycles":
        from lib.cycles_peer import CyclesPeer

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
        report = _report(opened, cold, runs)
        if cycles:
            ratios = [run.seconds / other for run, other in zip(runs, cycles_runs, strict=True)]
            report |= {
                "cycles": summary(cycles_runs) | {"device": cycles.device},
                "raybatch_over_cycles": round(statistics.median(ratios), 3),
                "ray_tracing_cores": has_ray_tracing_cores(device),
            }
        if request.equal_error:
            steps.begin("renders with other seeds, for the error")
            ours = [combined(session.render(opened.scene, settings.replace(seed=seed))) for seed in SEEDS]
            theirs = [cycles.picture(seed) for seed in SEEDS]
            report["equal_error"] = equal_error(
                report["raybatch"]["seconds"], ours, report["cycles"]["seconds"], theirs
            )
            steps.end()
        if picture:
            write_picture(picture, cold.film, opened.scene)
    finally:
        steps.close()
        session.close()
    return report


def _check_combination(request: RenderRequest) -> None:
    """Raise `UsageError` for options that do not go together."""
    if request.samples_longer:
        if request.samples_longer <= request.samples:
            raise UsageError(
                f"--samples {request.samples},{request.samples_longer} is not valid: the second count must be larger"
            )
        if request.against == "memory" or request.equal_error:
            raise UsageError(
                "two --samples tell the time of a sample, of RayBatch alone or --against cycles, at equal error too: "
                "leave --equal-error and --against memory out"
            )
        if request.against == "devices":
            raise UsageError("--against devices takes one count of --samples")
    if request.equal_error and request.against != "cycles":
        raise UsageError("--equal-error compares two engines: give --against cycles too")
    if request.against == "cycles" and kind_of(request.scene.path) != BLEND:
        raise UsageError(f"--against cycles needs a .blend, not {request.scene.path.name}")
    if request.against == "memory":
        if not request.budgets:
            raise UsageError(
                "--against memory compares budgets of geometry with all of it in memory: give --budgets, such as 10% "
                "or 1.5G,0.7G"
            )
        return
    for given, option in ((request.budgets, "--budgets"), (not request.counters, "--no-counters")):
        if given:
            raise UsageError(f"{option} belongs to the comparison with a render in memory: give --against memory too")


def _report(opened: OpenedScene, cold: TimedRender, runs: list[TimedRender]) -> dict[str, Any]:
    stages = {stage: summary([run.film.statistics["seconds"][stage] for run in runs]) for stage in ("build", "render")}
    return {
        **scene_report(opened, runs[-1].film.statistics),
        "cold": {"seconds": round(cold.seconds, 3), "stages": cold.film.statistics["seconds"]},
        "raybatch": summary([run.seconds for run in runs]) | stages,
    }


def equal_error(
    our_seconds: float, ours: list[np.ndarray], their_seconds: float, theirs: list[np.ndarray]
) -> dict[str, Any]:
    """Compare two unbiased engines by the time that each needs for the same error.

    `ours` and `theirs` are two independent pictures each, float64 [height, width, 3], which took `our_seconds` and
    `their_seconds` apiece. The noise of a picture is half the mean squared difference of the two, each pixel's divided
    by its squared brightness (relMSE); the brightness is that of all four, so that both engines are divided by the
    same. Time and error are taken as inversely proportional, so time x relMSE is what is compared.
    """
    errors = relmse_of_pairs(ours, theirs)
    means = [float(np.mean(pictures)) for pictures in (ours, theirs)]
    costs = [our_seconds * errors[0], their_seconds * errors[1]]
    return {
        "relmse": {"raybatch": errors[0], "cycles": errors[1]},
        "efficiency": {"raybatch": quotient(1, costs[0]), "cycles": quotient(1, costs[1])},
        "raybatch_seconds_to_cycles_error": quotient(costs[0], errors[1]),
        "raybatch_over_cycles": quotient(costs[0], costs[1]),
        "mean_ratio": quotient(means[0], means[1]),  # of the pictures' brightness: 1 where both render the same
    }
