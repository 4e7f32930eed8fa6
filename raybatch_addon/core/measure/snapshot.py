"""A picture on the way: what an observer is handed while a render runs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The picture when every pixel that gets samples had the same number of them.

    Seconds, rays and invalid samples are of this call of `Session.render`: what was done before a resume is in the
    picture and in `samples` alone.
    """

    samples: int  # of every pixel so far, or of those that have most
    seconds: float  # of rendering alone, without what observers did meanwhile
    seconds_total: float  # since the call of `Session.render`: with build and compile
    rays: dict[str, int]  # traced so far: "camera", "bounced", "shadow"
    invalid_samples: int
    # linear RGB, float32, shape [region height, region width, 3], bottom row first; the receiver's own copy
    picture: np.ndarray
    # the same of either half of the samples; None: they are not kept apart
    halves: tuple[np.ndarray, np.ndarray] | None = None
    # samples of each pixel, int, shape [region height, region width]; None: all have `samples`
    counts: np.ndarray | None = None

    # passes of the film that guide a denoiser, by name, as the picture; copies too
    guides: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def each(self) -> int | np.ndarray:
        """Samples of every pixel, or of each."""
        return self.samples if self.counts is None else self.counts

    @property
    def samples_mean(self) -> float:
        """Samples of a pixel, in the mean; an integer where all have as many."""
        return self.samples if self.counts is None else float(self.counts.mean())
