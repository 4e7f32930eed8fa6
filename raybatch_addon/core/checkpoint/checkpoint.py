"""A checkpoint in use: a render goes on from its file, and a thread keeps the file up to date.

To be copied, sums must stand still: the workers bring what they have begun to its end, which is what a stop does too.
Then they go on, and the thread packs and writes the copy.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warp as wp

from ..film import Film
from ..film.host_samples import HostSamples
from ..film.sums import ExactSums
from ..film.tile import FinishedTile
from ..scene.description import Scene
from ..settings.settings import RenderSettings
from ..wavefront.render.resume import ResumeState
from . import INTERVAL_DEFAULT
from .file import CheckpointError, KeptFilm, load_kept, remove_leftovers, write_kept
from .identity import FilmIdentity
from .progress import KeptProgress
from .samples import TileSamples, samples_as_arrays

# Keeping a film takes no more than this share of the time: where it would, the interval is longer
SHARE_MOST = 0.05
_ASIDE = ".old"  # ends the name of a checkpoint that another render took the place of


@dataclass(frozen=True)
class _Copy:
    """A render as it was when its workers stood still."""

    progress: KeptProgress
    halves: list[list[TileSamples]]  # by half and tile
    mark: tuple


class Checkpoint:
    """A file that one render goes on from, if it is there and fits, and that the render keeps up to date."""

    def __init__(
        self,
        path: str | Path,
        interval: float = INTERVAL_DEFAULT,
        *,
        begins_anew: bool = False,
        report: Callable[[str], object] = lambda text: None,
    ):
        """The file is written every `interval` seconds, and at the end. `report` gets what the user should know.

        One that is there and does not fit is an error; with `begins_anew` the render begins anew, a warning says why,
        and the old file stays beside the new one unless all of its samples were there.
        """
        self.path, self.interval, self._begins_anew = Path(path).absolute(), interval, begins_anew
        self._report = report
        self.warnings: list[str] = []
        self.samples_before = 0.0  # of a pixel in the mean, that were there
        self._identity: FilmIdentity | None = None
        self._mark: tuple | None = None  # how far the render has come in the file
        self._writing: threading.Thread | None = None
        self._asked_at: float | None = None  # when the workers were asked to stop for it
        self._next_at = float("inf")
        self._stopped_seconds = self._writing_seconds = 0.0
        self._cost = 0.0  # of keeping the film once [s]
        self._count = self._bytes = 0

    # --- before the render

    def begin(self, scene: Scene, settings: RenderSettings, device: wp.Device, sample_first: int) -> Film | None:
        """The film to go on with; None where the render begins. Raises `CheckpointError` where a file is there that
        cannot be gone on with.
        """
        self._identity = identity = FilmIdentity.of(scene, settings, device)
        remove_leftovers(self.path)
        if not os.path.lexists(self.path):
            return None
        kept = None
        try:
            kept = load_kept(self.path)
            if reason := why_not_gone_on(kept, identity, sample_first):
                raise CheckpointError(
                    f"{self.path} cannot be gone on with: {reason}; render as it was begun, or name another checkpoint"
                )
        except CheckpointError as error:
            if not self._begins_anew:
                raise
            self._put_aside(kept, error)
            return None
        film = kept.film()
        film.complete, film.resume_state = False, kept.progress.state(settings, film.region)
        self._mark = _mark(film.resume_state)
        self.samples_before = film.sample_total / scene.frame.pixel_count
        self._report(
            f"goes on from {self.path}: {self.samples_before:.5g} of {settings.sample_count:,} samples are there"
        )
        return film

    def _put_aside(self, kept: KeptFilm | None, error: CheckpointError) -> None:
        is_over = kept is not None and kept.progress.end is None
        aside = self.path.with_name(self.path.name + _ASIDE)
        where = ""
        if not is_over:
            try:
                os.replace(self.path, aside)
                where = f" (the old file is now {aside.name})"
            except OSError as trouble:
                raise CheckpointError(f"{error}; nor can it be renamed: {trouble.strerror or trouble}") from error
        self.warnings.append(f"the render begins anew{where}: {error}")

    # --- while it goes on

    def start(self) -> None:
        """The first ray is about to be traced."""
        self._next_at = time.perf_counter() + self.interval

    def is_due(self) -> bool:
        """See `StateKeeper.is_due`."""
        now = time.perf_counter()
        if now < self._next_at or (self._writing and self._writing.is_alive()):
            return False
        self._asked_at = self._asked_at or now
        return True

    def keep(self, state: ResumeState) -> None:
        """See `StateKeeper.keep`."""
        begun = time.perf_counter()
        self.wait()
        copy = _Copy(KeptProgress.of(state), _samples(state), _mark(state))
        stopped = time.perf_counter() - (self._asked_at or begun)
        self._stopped_seconds += stopped
        self._asked_at, self._next_at = None, float("inf")
        self._writing = threading.Thread(target=self._write, args=(copy, begun, stopped), daemon=True)
        self._writing.start()

    def end(self, state: ResumeState) -> None:
        """The render is over, or stopped: keep what is new."""
        self.wait()
        is_begun = any(each.held for each in state.states)
        if state.drained and is_begun and _mark(state) != self._mark:
            self._asked_at = None
            self.keep(state)
            self.wait()
        elif not state.drained:
            self.warnings.append(
                f"rays were given up when the render was stopped: {self.path.name} has the samples of the last interval"
                if self._count or self.samples_before
                else f"rays were given up when the render was stopped, so {self.path.name} was not written"
            )
        if state.policy.stopped_by is None and (self._count or self.samples_before):
            self._report(f"stopped; the same render goes on from {self.path}")

    def wait(self) -> None:
        """Until what is being written is there."""
        if self._writing:
            self._writing.join()
            self._writing = None

    @property
    def statistics(self) -> dict[str, Any]:
        """What was kept, and what that took."""
        return {
            "file": str(self.path),
            "samples_before": self.samples_before,
            "written": self._count,
            "bytes": self._bytes,
            "seconds_stopped": round(self._stopped_seconds, 6),
            "seconds_writing": round(self._writing_seconds, 6),
            "interval": round(self._interval(), 3),
        }

    def _interval(self) -> float:
        """From one copy to the next [s]."""
        return max(self.interval, self._cost / SHARE_MOST)

    def _write(self, copy: _Copy, begun: float, stopped: float) -> None:
        """On the thread that writes."""
        assert self._identity is not None  # since `begin`
        part, written_from = self._identity.part, time.perf_counter()
        try:
            arrays = (samples_as_arrays(part, tiles) for tiles in copy.halves)
            self._bytes = write_kept(self.path, self._identity, copy.progress, arrays)
            self._count += 1
            self._mark = copy.mark
        except OSError as error:
            self._warn(error.strerror or str(error))
        except Exception as error:  # the render is not lost with it
            self._warn(f"{type(error).__name__}: {error}")
        seconds = time.perf_counter() - written_from
        self._writing_seconds += seconds
        self._cost = stopped + seconds
        self._next_at = begun + self._interval()

    def _warn(self, why: str) -> None:
        there = "what it held before is still there" if self.path.exists() else "there is none now"
        text = f"the checkpoint {self.path} could not be written: {why}; the render goes on, and {there}"
        if text not in self.warnings:
            self.warnings.append(text)


def why_not_gone_on(kept: KeptFilm, identity: FilmIdentity, sample_first: int) -> str:
    """Why a render of `identity` cannot go on from what is `kept`; empty where it can."""
    progress, began, asked = kept.progress, kept.identity.settings, identity.settings
    if reason := identity.why_not(kept.identity):
        return reason
    if progress.sample_first != sample_first:
        return f"its samples begin at {progress.sample_first}, and {sample_first} is asked for"
    if asked["sample_count"] < began["sample_count"]:
        return f"it was begun for {began['sample_count']} samples, and now sample_count is {asked['sample_count']}"
    is_more = asked["sample_count"] > began["sample_count"]
    if is_more and asked["error_target"] > 0 and progress.end is None and progress.done == began["sample_count"]:
        return (
            "it has all samples that were asked for, and with error_target, which looks at the error at the end, "
            "more of them would not be the film of one render"
        )
    return ""


def _mark(state: ResumeState) -> tuple:
    """Changes when samples come."""
    return state.done, state.end, sum(each.items_begun for each in state.states)


def _samples(state: ResumeState) -> list[list[TileSamples]]:
    """The samples of each half, tile by tile, which the render does not change."""
    halves = range(len(state.tiles[0]))
    return [[_copy(held) for tiles in state.tiles if (held := tiles[half].held)] for half in halves]


def _copy(tile: FinishedTile) -> TileSamples:
    assert tile.film is not None, "a half is no sum of halves"
    samples = tile.fetch()
    if tile.film.window.device.is_cpu:  # arrays there are the device's own
        sums = ExactSums(samples.sums.window.copy(), samples.sums.wide.copy(), samples.sums.channels)
        samples = HostSamples(
            sums,
            samples.counts.copy(),
            {name: values.copy() for name, values in samples.first.items()},
            {name: values.copy() for name, values in samples.cost.items()},
            samples.mattes,
        )
    return TileSamples(tile.rectangle, samples)
