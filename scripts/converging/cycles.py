"""Cycles as a competitor: renders at increasing sample counts."""

from __future__ import annotations

import math

import numpy as np
import warp as wp
from benchmarking.whole_render import OpenedScene
from lib.command import UsageError
from lib.cycles_peer import CyclesPeer

from raybatch_addon.core.convergence.points import geometric_samples
from raybatch_addon.core.measure.snapshot import Snapshot
from raybatch_addon.core.settings.settings import RenderSettings

# How the names of switches begin by which a view layer asks for passes
PASSES = ("use_pass_", "pass_", "denoising_store_passes")
GROWTH = 2  # of samples from one render to the next
WORTHWHILE = 1.1  # the last render under a time limit has at least this many times the samples of the one before


def open_peer(opened: OpenedScene, device: wp.Device, settings: RenderSettings) -> CyclesPeer:
    """Cycles, without bias, with the samples, bounces, filter and threads of `settings`, and the picture alone; raises
    `UsageError`.
    """
    for layer in opened.blender_scene.view_layers:
        for group in (layer, layer.cycles):
            for name in group.bl_rna.properties.keys():
                if name.startswith(PASSES) and isinstance(getattr(group, name), bool):
                    setattr(group, name, name == "use_pass_combined")
    return CyclesPeer(opened.blender_scene, device, settings, settings.thread_count)


def require_size(picture: np.ndarray, size: tuple[int, int]) -> None:
    """Raise `UsageError` where Cycles rendered another part of the frame than RayBatch, whose width and height are
    `size`.
    """
    found = picture.shape[1], picture.shape[0]
    if found != tuple(size):
        raise UsageError(
            f"Cycles rendered {found[0]} x {found[1]} pixels and RayBatch {size[0]} x {size[1]}: turn the render "
            "border off"
        )


def cycles_snapshots(peer: CyclesPeer, seed: int, sample_count: int, seconds: float | None) -> list[Snapshot]:
    """Pictures of renders of their own, at a geometric series of sample counts up to `sample_count`, or as far as
    `seconds` of rendering allow.
    """
    taken: list[tuple[int, float, np.ndarray]] = []
    for samples in [1] if seconds else geometric_samples(sample_count, GROWTH):
        taken.append((samples, *peer.timed_picture(seed, samples)))
    while seconds and (more := samples_next([(n, s) for n, s, _ in taken], sample_count, seconds)):
        taken.append((more, *peer.timed_picture(seed, more)))
    begun = setup_seconds([(n, s) for n, s, _ in taken])
    return [
        Snapshot(
            samples=n,
            seconds=s - begun,
            seconds_total=s,
            rays={},
            invalid_samples=0,
            picture=np.asarray(picture, np.float32),
        )
        for n, s, picture in taken
    ]


def setup_seconds(times: list[tuple[int, float]]) -> float:
    """What of each render is not rendering, from the (samples, seconds) of whole ones: synchronisation, the tree, start
    and end.

    A line through the first and the last shows the seconds of a sample; what no render took less than beside its
    samples is set-up.
    """
    (first, begun), (last, ended) = times[0], times[-1]
    rate = (ended - begun) / (last - first) if last > first else 0.0
    return max(0.0, min(s - n * rate for n, s in times)) if rate > 0 else 0.0


def samples_next(times: list[tuple[int, float]], sample_count: int, limit: float) -> int | None:
    """Samples of the next render, of which `limit` seconds of rendering allow; None: the last was the longest."""
    last = times[-1][0]
    rest = times[-1][1] - setup_seconds(times)
    fitting = math.floor(limit * last / rest) if rest > 0 and len(times) > 1 else GROWTH * last
    samples = min(GROWTH * last, fitting, sample_count)
    return samples if samples >= WORTHWHILE * last else None
