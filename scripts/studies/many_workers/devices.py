"""Several GPUs of one process: tiles are dealt to their workers, and parted, by the renderer's own rules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from raybatch_addon.core.wavefront.render.deal import Deal
from raybatch_addon.core.wavefront.render.steps import LEFT_SHARE, TileParts
from raybatch_addon.core.wavefront.scheduler import CUDA_WORKERS

PIXELS = 3840 * 2160


@dataclass(frozen=True)
class Shared:
    """A picture of 3840 x 2160 pixels that GPUs of a process share."""

    name: str
    samples: int
    seconds: float  # of one GPU
    spread: float  # of the seconds of tiles (standard deviation of their logarithm)
    tiles: int
    gpus: int
    speedup: float = 0.0  # measured; 0: it was not

    @property
    def words(self) -> str:
        """For a table."""
        return f"{self.name}, {self.samples} samples, {self.gpus} GPUs of a process"


@dataclass
class _Gpu:
    """One whose workers share its time evenly."""

    left: dict[int, float] = field(default_factory=dict)  # seconds of a worker's tile, had it the GPU for itself

    def next_end(self) -> tuple[float, int]:
        """In how many seconds which worker is through with its tile."""
        worker = min(self.left, key=self.left.__getitem__)
        return self.left[worker] * len(self.left), worker

    def go_on(self, seconds: float) -> None:
        """So much time passes."""
        for worker in self.left:
            self.left[worker] -= seconds / len(self.left)


def dealt_seconds(tiles: Sequence[float], samples: int, count: int) -> float:
    """When `count` GPUs are through with tiles that take one GPU so many seconds for `samples` samples. Tiles are dealt
    and parted by the renderer's own rules.
    """
    deal, parts = Deal((tile, None, math.inf) for tile in range(len(tiles))), TileParts()
    left, pixels, workers = [samples] * len(tiles), PIXELS / len(tiles), count * CUDA_WORKERS
    gpus, under_way, now = [_Gpu() for _ in range(count)], {}, 0.0

    def take(worker: int) -> None:
        tile = deal.take(worker // CUDA_WORKERS)
        if tile is None:
            return
        share = LEFT_SHARE / workers * sum(left)
        its = parts.samples(tile, left[tile], int(pixels), share)
        left[tile] -= its
        under_way[worker] = tile, its, now
        gpus[worker // CUDA_WORKERS].left[worker] = its / samples * tiles[tile]

    for worker in range(workers):
        take(worker)
    while under_way:
        (seconds, worker), place = min((gpu.next_end(), i) for i, gpu in enumerate(gpus) if gpu.left)
        for gpu in gpus:
            if gpu.left:
                gpu.go_on(seconds)
        now += seconds
        del gpus[place].left[worker]
        tile, its, begun = under_way.pop(worker)
        parts.note(tile, int(its * pixels), now - begun)
        if left[tile]:
            deal.put_back(tile, place, parts.seconds(tile, int(left[tile] * pixels)))
        take(worker)
    return now


def process_seconds(case: Shared, lost: float) -> float:
    """What the picture takes its GPUs, in the mean of some draws of its tiles' times. `lost`: seconds that a render by
    several takes beyond its samples, however many these are.
    """
    found = []
    for seed in range(8):
        tiles = np.exp(np.random.default_rng(seed).normal(0.0, case.spread, case.tiles))
        tiles *= case.seconds / tiles.sum()
        found.append(dealt_seconds(tiles.tolist(), case.samples, case.gpus))
    return float(np.mean(found)) + (lost if case.gpus > 1 else 0.0)


def amdahl(count: float, serial: float) -> float:
    """The speedup of `count` where the share `serial` of the work of one is not shared (Amdahl 1967)."""
    return 1.0 / (serial + (1.0 - serial) / count)


def serial_share(count: float, speedup: float) -> float:
    """The inverse of `amdahl`."""
    return (count / speedup - 1.0) / (count - 1.0)
