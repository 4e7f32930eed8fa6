"""The cost of recording a render: beside the same render that nobody watches."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from lib.films import differing_passes

from benchmarking.progress import Steps
from benchmarking.timing import summary
from benchmarking.whole_render import RenderRequest, open_scene, scene_report
from raybatch_addon.blender.kernel_cache import kernel_cache_folder
from raybatch_addon.core.convergence.points import ConvergenceRecorder
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings


@dataclass(frozen=True)
class Way:
    """One way to render."""

    name: str
    error_estimate: str
    records: bool


# The first is what the others are compared with
WAYS = (
    Way("plain", "OFF", False),
    Way("recorded", "OFF", True),
    Way("error estimate", "ON", False),
    Way("error estimate, recorded", "ON", True),
)


def measure_recording(request: RenderRequest) -> dict[str, Any]:
    """The report of `benchmark.py recording`; raises `RayBatchError`.

    Times are seconds of processor time of a whole render on the CPU, all threads together, which others on the machine
    disturb less than the wall's; on CUDA seconds of rendering. Ways take turns, and each begins a turn as often as any
    other.
    """
    opened = open_scene(request)
    settings = opened.settings.replace(
        sample_count=request.samples, bounce_max=request.bounces, thread_count=request.threads
    )
    settings = settings.replace(**request.settings).replace(error_target=0.0, time_limit=0.0)
    session = Session(find_device(request.device).alias, settings, kernel_cache_folder())
    seconds: dict[Way, list[float]] = {way: [] for way in WAYS}
    rounds, films, invalid = dict.fromkeys(WAYS, 1), {}, 0
    steps = Steps(1 + request.runs)
    try:
        steps.begin("compilation")
        for way in WAYS:
            _render(session, opened.scene, settings.replace(sample_count=min(2, request.samples)), way)
        steps.end()
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            for place in range(len(WAYS)):
                way = WAYS[(run + place) % len(WAYS)]
                took, film, rounds[way] = _render(session, opened.scene, settings, way)
                seconds[way].append(took)
                films.setdefault(way, film)
                invalid = max(invalid, film.statistics["invalid_samples"])
            steps.end()
    finally:
        steps.close()
        session.close()
    plain = films[WAYS[0]].statistics
    return {
        **scene_report(opened, plain),
        "invalid_samples": invalid,
        "clock": "processor" if session.device.is_cpu else "rendering",
        "ways": [_way_report(way, seconds[WAYS[0]], seconds[way], rounds[way]) for way in WAYS],
        "films": _compared(films),
    }


def _render(session: Session, scene: Scene, settings: RenderSettings, way: Way) -> tuple[float, Film, int]:
    """Seconds, the film, and how many rounds there were."""
    recorder = ConvergenceRecorder()
    began = time.process_time()
    film = session.render(
        scene, settings.replace(error_estimate=way.error_estimate), observers=[recorder] if way.records else []
    )
    took = time.process_time() - began
    if session.device.is_cuda:
        took = film.statistics["seconds"]["render"]
    return took, film, max(1, len(recorder.snapshots))


def _way_report(way: Way, plain: Sequence[float], seconds: Sequence[float], rounds: int) -> dict[str, Any]:
    """`cost` is the share of the plain render's time that comes on top: the median over turns, and between which two
    half of them lie.
    """
    costs = [mine / other - 1 for mine, other in zip(seconds, plain, strict=True)]
    least, middle, most = (float(each) for each in np.quantile(costs, (0.25, 0.5, 0.75)))
    added = statistics.median(mine - other for mine, other in zip(seconds, plain, strict=True))
    return {
        "way": way.name,
        "error_estimate": way.error_estimate,
        "recorded": way.records,
        "rounds": rounds,
        **summary(seconds),
        "cost": round(middle, 5),
        "cost_half": [round(least, 5), round(most, 5)],
        "seconds_added": round(added, 5),
    }


def _compared(films: dict[Way, Film]) -> dict[str, Any]:
    """Whether a film is the same recorded or not, bit for bit."""
    differences = []
    for estimate in ("OFF", "ON"):
        alone, recorded = (films[way] for way in WAYS if way.error_estimate == estimate)
        if differing_passes(alone.passes, recorded.passes):
            differences.append(f"recorded, with error_estimate {estimate}")
    return {"compared": len(films), "equal": not differences, "differences": differences}
