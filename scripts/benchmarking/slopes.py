"""Whole renders with two sample counts: what an engine takes once, and what each sample takes.

An engine that loads or compiles kernels, or builds trees, for longer than it samples is distinguished from one whose
samples are slow.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from benchmarking.progress import Steps
from benchmarking.timing import spread
from benchmarking.whole_render import OpenedScene, RenderRequest, scene_report, timed_render
from raybatch_addon.core.convergence.errors import RELMSE_MOST, RELMSE_OFFSET
from raybatch_addon.core.film import Film
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings

SEEDS = (1, 2)
# Names of NVIDIA's devices for computing, which have no ray-tracing cores
WITHOUT_RAY_TRACING_CORES = ("A100", "A800", "H100", "H200", "H800", "GH200", "B100", "B200", "GB200", "V100", "P100")


@dataclass
class Timed:
    """The times that an engine took: whole renders of two sample counts, in turns."""

    shorter: list[float] = field(default_factory=list)  # [s]
    longer: list[float] = field(default_factory=list)  # [s]
    pictures: list[np.ndarray] = field(default_factory=list)  # of the longer, a seed each, float64 [height, width, 3]

    def report(self, counts: tuple[int, int]) -> dict[str, Any]:
        """Medians: a sample's time, and what a render takes beside its samples (of turns, so that drift cancels)."""
        slopes = [(b - a) / (counts[1] - counts[0]) for a, b in zip(self.shorter, self.longer, strict=True)]
        fixed = [a - counts[0] * slope for a, slope in zip(self.shorter, slopes, strict=True)]
        return {
            "seconds": [round(statistics.median(each), 4) for each in (self.shorter, self.longer)],
            "ms_a_sample": round(1000 * statistics.median(slopes), 4),
            "ms_a_sample_least": round(1000 * min(slopes), 4),
            "ms_a_sample_most": round(1000 * max(slopes), 4),
            "fixed_seconds": round(statistics.median(fixed), 4),
            "spread": round(max(spread(self.shorter), spread(self.longer)), 3),
            "runs": len(slopes),
        }


def measure_slopes(
    session: Session, opened: OpenedScene, settings: RenderSettings, request: RenderRequest, device: wp.Device
) -> tuple[dict[str, Any], Film]:
    """The report of `benchmark.py render` with two sample counts, and the first film; raises `RayBatchError`.

    Cycles, where it is asked for, is measured on every kind of device that it offers there (OptiX and CUDA), and the
    one whose samples are quicker is the peer. The first render of each engine, which loads or compiles kernels, is no
    run, and stated apart.
    """
    from lib.cycles_peer import CyclesPeer, kinds_offered

    counts = request.counts
    kinds = kinds_offered(device) if request.against == "cycles" else ()
    peers = {kind: CyclesPeer(opened.blender_scene, device, settings, settings.thread_count, kind) for kind in kinds}
    steps = Steps(1 + len(kinds) + request.runs)
    try:
        steps.begin("RayBatch: first render, with compilation")
        cold = timed_render(session, opened.scene, settings.replace(sample_count=counts[0]))
        steps.end()
        first = {"RayBatch": cold.seconds}
        for kind, peer in peers.items():
            steps.begin(f"Cycles ({kind}): first render, with what it loads")
            first[kind] = peer.timed_picture(SEEDS[0], counts[0])[0]
            steps.end()
        timed = {name: Timed() for name in first}
        film = cold.film
        for run in range(request.runs):
            steps.begin(f"run {run + 1} of {request.runs}")
            seed = SEEDS[run % 2]
            for count in counts:
                render = timed_render(session, opened.scene, settings.replace(sample_count=count, seed=seed))
                film = render.film
                _note(timed["RayBatch"], count == counts[0], render.seconds, combined(film))
                for kind, peer in peers.items():
                    _note(timed[kind], count == counts[0], *peer.timed_picture(seed, count))
            steps.end()
    finally:
        steps.close()
    reports = {name: each.report(counts) | {"first_seconds": round(first[name], 3)} for name, each in timed.items()}
    report = {
        **scene_report(opened, film.statistics),
        "sample_counts": list(counts),
        "ray_tracing_cores": has_ray_tracing_cores(device),
        "raybatch": reports.pop("RayBatch"),
    }
    if kinds:
        report |= {"cycles": reports} | _beside(report["raybatch"], reports, timed)
    return report, cold.film


def has_ray_tracing_cores(device: wp.Device) -> bool | None:
    """Whether the device has cores for ray tracing, which OptiX uses and RayBatch does not; None for a CPU."""
    if not device.is_cuda:
        return None
    return not any(name in device.name for name in WITHOUT_RAY_TRACING_CORES)


def _note(timed: Timed, shorter: bool, seconds: float, picture: np.ndarray) -> None:
    (timed.shorter if shorter else timed.longer).append(seconds)
    if not shorter and len(timed.pictures) < len(SEEDS):
        timed.pictures.append(picture)


def _beside(ours: dict[str, Any], theirs: dict[str, dict[str, Any]], timed: dict[str, Timed]) -> dict[str, Any]:
    """RayBatch over the quickest kind of Cycles."""
    peer = min(theirs, key=lambda kind: theirs[kind]["ms_a_sample"])
    at_samples = quotient(ours["ms_a_sample"], theirs[peer]["ms_a_sample"])
    reported: dict[str, Any] = {
        "peer": peer,
        "slope_raybatch_over_cycles": at_samples,
        "fixed_raybatch_over_cycles": quotient(ours["fixed_seconds"], theirs[peer]["fixed_seconds"]),
    }
    pictures = [timed["RayBatch"].pictures, timed[peer].pictures]
    if all(len(each) == 2 for each in pictures):
        noise = relmse_of_pairs(*pictures)
        reported["relmse"] = {"raybatch": noise[0], "cycles": noise[1]}
        variance = quotient(*noise)
        reported["variance_raybatch_over_cycles"] = variance
        reported["equal_error_raybatch_over_cycles"] = None if None in (at_samples, variance) else at_samples * variance
        reported["mean_ratio"] = quotient(*(float(np.mean(each)) for each in pictures))
    return reported


def combined(film: Film) -> np.ndarray:
    """The colours of the film, float64 [height, width, 3]."""
    return film.passes["Combined"][..., :3].astype(np.float64)


def relmse_of_pairs(*pairs: list[np.ndarray]) -> list[float]:
    """The relMSE of a picture of each pair of independent ones, float64 [height, width, 3]: half the mean squared
    difference of the two, each pixel's divided by the square of its brightness in the mean of all pictures and cut at
    RELMSE_MOST, as in `real_files.measures`.
    """
    pictures = [picture for pair in pairs for picture in pair]
    square = (sum(pictures) / len(pictures)) ** 2 + RELMSE_OFFSET
    return [float(np.minimum((one - other) ** 2 / 2 / square, RELMSE_MOST).mean()) for one, other in pairs]


def quotient(a: float, b: float) -> float | None:
    """a / b with six digits; None where `b` is not above 0."""
    return float(f"{a / b:.6g}") if b > 0 else None
