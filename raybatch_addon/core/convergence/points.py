"""Error against run time: an observer that keeps pictures of a render under way, and what is made of them when it is
over.

    recorder = ConvergenceRecorder()
    session.render(scene, settings, observers=[recorder])
    points = recorder.points(reference)     # or without a reference, where `error_estimate` is ON
    print(fit_slope(points).says, time_to(points, 1e-3), efficiency(points))

While the render runs pictures are kept and nothing is computed; NumPy alone is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RayBatchError
from ..observers import RenderObserver
from .errors import (
    ErrorPoint,
    relative_to,
    relative_to_halves,
    relmse,
    relmse_cut,
    relmse_of_halves,
    rmse,
    rmse_of_halves,
    squared_error,
    squared_error_of_halves,
)
from .fit import Slope, efficiency, fit_slope, slope_data, time_to
from .reference import PICTURE_SETTINGS, Reference, load_reference, noise_floor, save_reference, scene_hash

if TYPE_CHECKING:
    from ..measure.snapshot import Snapshot

__all__ = [
    "PICTURE_SETTINGS",
    "ConvergenceRecorder",
    "ErrorPoint",
    "Reference",
    "Slope",
    "efficiency",
    "error_point",
    "fit_slope",
    "geometric_samples",
    "load_reference",
    "noise_floor",
    "relmse",
    "relmse_of_halves",
    "rmse",
    "rmse_of_halves",
    "save_reference",
    "scene_hash",
    "slope_data",
    "time_to",
]


def geometric_samples(sample_count: int, ratio: float = 2.0, first: int = 1) -> list[int]:
    """Sample counts from `first` on, each `ratio` times the last (rounded, and at least one more); the last is
    `sample_count`.
    """
    if not ratio > 1:
        raise ValueError(f"sample counts must grow, so their ratio must be above 1 and is {ratio}")
    if sample_count < 1 or first < 1:
        raise ValueError(f"there are no sample counts from {first} to {sample_count}: use 1 or more")
    counts: list[int] = []
    wanted = float(first)
    while wanted < sample_count - 0.5:
        count = max(round(wanted), counts[-1] + 1 if counts else 1)
        if count >= sample_count:
            break
        counts.append(count)
        wanted = max(wanted * ratio, count * 1.0)
    return [*counts, sample_count]


class ConvergenceRecorder(RenderObserver):
    """An observer of `Session.render` that keeps a snapshot at every sample count of a geometric series. One for each
    call of it.
    """

    def __init__(self, ratio: float = 2.0):
        """`ratio`: of one snapshot's samples to those of the one before, above 1."""
        if not ratio > 1:
            raise ValueError(f"sample counts must grow, so their ratio must be above 1 and is {ratio}")
        self.ratio = ratio
        self.snapshots: list[Snapshot] = []

    def snapshot_samples(self, sample_count: int) -> Sequence[int]:
        """Where the session is to stop and show what it has."""
        return geometric_samples(sample_count, self.ratio)

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Keep it; nothing else is done while the render runs."""
        last = self.snapshots[-1] if self.snapshots else None
        if last and (snapshot.samples <= last.samples or snapshot.seconds_total < last.seconds_total):
            raise ValueError("a convergence recorder is for one call of render: make another for the next")
        self.snapshots.append(snapshot)

    def points(
        self, reference: Reference | None = None, flip: Callable[[np.ndarray, np.ndarray], float] | None = None
    ) -> list[ErrorPoint]:
        """The error at every snapshot: against `reference`, else as the difference of the two halves shows it.

        `flip(picture, reference)` is called, if given, with two linear float32 pictures [height, width, 3], top row
        first, and there is a reference. Without one, snapshots before both halves have a sample give no point. Raises
        `RayBatchError` where sizes differ, or nothing shows the error.
        """
        points = [
            error_point(snapshot, reference, flip)
            for snapshot in self.snapshots
            if reference is not None or _has_halves(snapshot)
        ]
        if self.snapshots and not points:
            raise RayBatchError(
                "nothing tells the error of this render: give a reference, or set error_estimate to ON (and "
                "sample_count to 2 or more)"
            )
        return points


def error_point(
    snapshot: Snapshot,
    reference: Reference | None = None,
    flip: Callable[[np.ndarray, np.ndarray], float] | None = None,
) -> ErrorPoint:
    """The error at one snapshot, see `ConvergenceRecorder.points`."""
    if reference is not None:
        error, scale = squared_error(snapshot.picture, reference.picture), relative_to(reference.picture)
        floor = noise_floor(reference)
    elif snapshot.halves is not None and _has_halves(snapshot):
        error = squared_error_of_halves(*snapshot.halves, snapshot.each)
        scale = relative_to_halves(*snapshot.halves)
        if snapshot.counts is not None:
            error, scale = (each[snapshot.counts >= 2] for each in (error, scale))
        floor = (0.0, 0.0)
    else:
        raise RayBatchError(
            "this snapshot has no halves: give a reference, or render with error_estimate ON and at least 2 samples"
        )
    root = math.sqrt(error.mean())
    perceived = None
    if flip is not None and reference is not None:
        perceived = float(flip(_upright(snapshot.picture), _upright(reference.picture)))
    floor_rmse, floor_relmse = (None if math.isnan(f) else f for f in floor)
    return ErrorPoint(
        seconds=snapshot.seconds,
        seconds_total=snapshot.seconds_total,
        samples=snapshot.samples_mean,
        samples_most=snapshot.samples,
        rays=dict(snapshot.rays),
        rmse=root,
        relmse=float((error / scale).mean()),
        relmse_cut=relmse_cut(error, scale),
        flip=perceived,
        invalid_samples=snapshot.invalid_samples,
        rmse_spread=_rmse_spread(error, root),
        floor_rmse=floor_rmse,
        floor_relmse=floor_relmse,
        from_halves=reference is None,
    )


def _rmse_spread(error: np.ndarray, root: float) -> float | None:
    """Standard error of the RMSE over pixels, whose errors are independent (channels are not): d rmse = d mse / 2
    rmse.
    """
    pixels = error.mean(axis=-1).ravel()
    if len(pixels) < 2:
        return None
    return float(pixels.std(ddof=1) / math.sqrt(len(pixels)) / (2 * root)) if root else 0.0


def _has_halves(snapshot: Snapshot) -> bool:
    return snapshot.halves is not None and np.max(snapshot.each) >= 2


def _upright(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture[::-1], np.float32)
