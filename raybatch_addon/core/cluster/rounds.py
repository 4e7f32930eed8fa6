"""The rounds of a cluster's render: how far samples may be dealt, and what is decided where all of them are here.

They are those of a render by one process: looks at the noise, and at the error, come at the same samples. Looks are
made here, on the processor: they add, multiply and divide, without fused steps, so that any device finds the same.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import warp as wp

from ..checkpoint.file import KeptFilm
from ..checkpoint.progress import KeptProgress
from ..convergence.halves import HalfError, half_error
from ..film import Film
from ..scene.description import Frame
from ..settings.settings import RenderSettings
from ..wavefront.adaptive.active_pixels import ActivePixels, HalfPictures
from ..wavefront.adaptive.ranges import first_active
from ..wavefront.render.rounds import RoundPolicy


class ClusterRounds:
    """Where the round under way ends, and which pixels get its samples."""

    def __init__(self, frame: Frame, settings: RenderSettings, sample_first: int, kept: KeptFilm | None = None):
        """`kept` are the samples to go on with. Raises `RayBatchError` for samples that cannot be rendered by
        themselves.
        """
        self._first, self.policy = sample_first, RoundPolicy.of(settings, (), sample_first)
        x0, y0, x1, y1 = map(int, frame.region)
        self.region = (x0, y0, x1, y1)  # [pixels]
        self.active = first_active(frame, settings, sample_first, None, wp.get_device("cpu"))
        self.error: HalfError | None = None  # when it was looked at last
        self.error_samples = 0  # of every pixel, then
        self.number = 0  # rounds that ended here
        done = 0
        if kept is not None:
            progress, done = kept.progress, kept.progress.done
            self.policy = RoundPolicy.of_record(settings.sample_count, progress.policy).resumed(settings, ())
            if self.active and progress.stopped is not None:
                self.active = ActivePixels(
                    self.active.region, progress.threshold, progress.stopped, list(progress.looks)
                )
        self._end = self.policy.next_end(done, 0.0, self.share)
        if kept is not None and self.is_over:
            self._look_at_error(kept.film(), done)

    @property
    def is_over(self) -> bool:
        """Whether no round is under way."""
        return self._end is None

    @property
    def end(self) -> int:
        """Behind the last sample of the round under way, or of the last one."""
        return self._first + (self.policy.sample_count if self._end is None else self._end)

    @property
    def share(self) -> float:
        """Share of the pixels that get samples."""
        return self.active.share if self.active else 1.0

    @property
    def stopped(self) -> np.ndarray | None:
        """Which pixels have ended their sampling, as `ActivePixels.stopped`; None before the first look."""
        return self.active.stopped if self.active and self.active.looks else None

    def after(self, kept: KeptFilm) -> tuple[ClusterRounds, Film | None]:
        """What comes next where all samples of the round are in `kept`, with all before; and the film, if it was looked
        at. This one stays as it is.
        """
        following = copy.copy(self)
        following.policy = copy.copy(self.policy)
        following.number += 1
        return following, following._look(kept)

    def _look(self, kept: KeptFilm) -> Film | None:
        policy, done = self.policy, kept.progress.done
        film, found = None, None
        if policy.looks_at_noise(done):
            assert self.active is not None  # or there are no looks
            film, device = kept.film(), wp.get_device("cpu")
            self.active = self.active.copy()
            self.active.look([HalfPictures.of_film(film, device)], done, device)
        if policy.looks_at_error(done):
            film = film or kept.film()
            found = self._look_at_error(film, done)
        policy.note_round(0.0, 0.0, found and found.relmse)
        self._end = policy.next_end(done, 0.0, self.share)
        if self.is_over and self.error_samples != done:
            self._look_at_error(kept.film() if film is None else film, done)
        return film

    def _look_at_error(self, film: Film, done: int) -> HalfError | None:
        """None where one of the halves has no sample."""
        if not film.halves or done < 2:
            return None
        counts: int | np.ndarray = done
        if self.active:
            counts = np.maximum(self.active.counts(self._first + done) - self._first, 0)
        first, second = (half.passes["Combined"][..., :3] for half in film.halves)
        self.error, self.error_samples = half_error(first, second, counts), done
        return self.error

    def progress(self, progress: KeptProgress) -> KeptProgress:
        """`progress` of a film with what was decided so far, for a checkpoint."""
        active = self.active
        return dataclasses.replace(
            progress,
            policy=self.policy.record(),
            threshold=active.threshold if active else 0.0,
            looks=tuple(active.looks) if active else (),
            stopped=active.stopped if active else None,
        )
