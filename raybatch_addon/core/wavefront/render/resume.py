"""How far a render has come, and what goes on when it is resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ...device.devices import free_memory
from ...errors import OutOfMemoryError, RayBatchError
from ...film import Film
from ...host_memory import size_text
from ...measure.memory import film_bytes
from ...scene.description import Frame
from ...settings.denoise import DenoiseSettings
from ...settings.info import INT_MAX, infos_of
from ...settings.settings import SETTINGS, RenderSettings
from ..adaptive.active_pixels import ActivePixels, HalfPictures
from ..integrator import TileState
from ..scheduler import tiles
from ..stages.generate import ITEMS_NUMBERED
from .rounds import Round, RoundPolicy

# Settings that no sum of the film depends on: when a render ends, by the clock, and how its picture is denoised
_NO_SUMS = ("time_limit", *infos_of(DenoiseSettings))


@dataclass(kw_only=True)
class ResumeState:
    """How far a render has come."""

    tiles: list[tuple[TileState, ...]]  # with one state for each half
    sample_first: int
    sample_order: str
    estimator: dict[str, Any]  # the settings that the film depends on
    policy: RoundPolicy
    done: int = 0  # samples of every pixel, of this render, at the end of the last round
    end: int | None = None  # the same at the end of the round that is under way; None: between rounds
    active: ActivePixels | None = None  # which pixels get samples; None: all
    invalid_samples: int = 0  # not finite, and counted as black

    @staticmethod
    def begin(
        settings: RenderSettings,
        frame: Frame,
        edge: int,
        sample_first: int,
        policy: RoundPolicy,
        active: ActivePixels | None = None,
    ) -> ResumeState:
        """The state of a render that begins, with tiles of `edge` pixels."""
        halves = range(settings.half_count)
        states = [tuple(TileState(tile, half=half) for half in halves) for tile in tiles(frame.region, edge)]
        return ResumeState(
            tiles=states,
            sample_first=sample_first,
            sample_order=settings.sample_order,
            estimator=estimator_settings(settings),
            policy=policy,
            active=active,
        )

    @property
    def states(self) -> list[TileState]:
        """The states of all halves of all tiles."""
        return [state for halves in self.tiles for state in halves]

    @property
    def pixel_count(self) -> int:
        """Pixels of all tiles together."""
        return sum(halves[0].tile.pixel_count for halves in self.tiles)

    @property
    def samples_so_far(self) -> Round:
        """Which samples every pixel has."""
        return Round(self.sample_first, self.sample_first + self.done)

    def samples_of(self, state: TileState) -> Round:
        """Which samples of its half a tile gets in the round under way."""
        return self._samples_to(self.end, state)

    def _samples_to(self, end: int, state: TileState) -> Round:
        return Round(self.sample_first + self.done, self.sample_first + end).of_half(state.half, len(self.tiles[0]))

    @property
    def share(self) -> float:
        """Share of the pixels that get samples in the round to come."""
        return self.active.share if self.active else 1.0

    @property
    def counts(self) -> int | np.ndarray:
        """Samples of every pixel of this render, or of each, int, shape [height, width]."""
        if self.active is None:
            return self.done
        return np.maximum(self.active.counts(self.sample_first + self.done) - self.sample_first, 0)

    def items_left(self, state: TileState) -> int:
        """Paths of the round under way that a tile, or one half of its samples, has not begun."""
        return state.pixel_count * self.samples_of(state).sample_count - state.items_begun

    @property
    def open_tiles(self) -> list[tuple[TileState, ...]]:
        """Tiles of which not all paths of the round under way were begun."""
        return [halves for halves in self.tiles if self.items_left_of(halves)]

    @property
    def open_tiles_behind_first(self) -> list[tuple[TileState, ...]]:
        """The same, those with the fewest samples of the round first; equal ones in the order of the tiles."""

        def samples_begun(halves: Sequence[TileState]) -> float:
            return sum(each.items_begun for each in halves) / sum(each.pixel_count for each in halves)

        return sorted(self.open_tiles, key=samples_begun)

    def items_left_of(self, halves: Sequence[TileState]) -> int:
        """The same of all halves of a tile."""
        return sum(map(self.items_left, halves))

    @property
    def items_open(self) -> int:
        """Paths of the round under way that were not begun."""
        return sum(self.items_left(state) for state in self.states)

    @property
    def items_to_come(self) -> int:
        """Paths that were not begun, of all rounds that there can be."""
        last = self.policy.sample_count
        return sum(
            each.pixel_count * self._samples_to(last, each).sample_count - each.items_begun for each in self.states
        )

    @property
    def drained(self) -> bool:
        """Whether all paths that were begun are in the film."""
        return all(state.drained for state in self.states)

    def shorten_round(self) -> bool:
        """Let the round under way end as soon as every pixel can have the same samples; False where it must be
        finished.

        A policy that is new, with a clock of its own, has no say in a round that was begun. Where samples of a pixel
        come one after another, those that are begun are spread over the whole round.
        """
        if self.end is None:
            return True
        if self.sample_order == "PIXEL_FIRST" and any(state.items_begun for state in self.states):
            return False
        # samples of a half
        begun = max(-(-state.items_begun // max(state.pixel_count, 1)) for state in self.states)
        self.end = min(self.end, self.done + max(begun, 1) * len(self.tiles[0]))
        return True

    @property
    def cannot_shorten(self) -> str:
        """Why `shorten_round` does nothing, as a warning."""
        return (
            "time_limit ends no round that was begun: samples come PIXEL_FIRST, so each pixel gets all "
            f"{self.end:,} of the one that was under way; render with sample_order FRAME_FIRST from the start"
        )

    def begin_round(self, end: int | None) -> None:
        """The round to come goes to `end`, or not so far: lists of active pixels number paths by 32 bits from the
        beginning of a round.
        """
        self.end = end
        if end is not None and self.active:
            largest = max(state.tile.pixel_count for state in self.states)
            self.end = min(end, self.done + max(ITEMS_NUMBERED // largest, 1) * len(self.tiles[0]))

    def end_round(self) -> None:
        """Every tile has all samples of the round."""
        self.done, self.end = self.end, None
        for state in self.states:
            state.items_begun = 0

    def look_at_noise(self) -> None:
        """End the sampling of pixels with little noise around them, between rounds."""
        device = self.tiles[0][0].held.film.window.device
        pictures = (HalfPictures.of_tile(*(state.held for state in halves)) for halves in self.tiles)
        self.active.look(pictures, self.done, device)

    def list_active(self, device: wp.Device | None = None) -> None:
        """Let the tiles know which pixels get samples, on `device`, or where their sums are."""
        if not self.active.stopped.any():
            return
        device = device or self.tiles[0][0].held.film.window.device
        lists = self.active.lists([halves[0].tile for halves in self.tiles], device)
        for halves, active in zip(self.tiles, lists, strict=True):
            for state in halves:
                state.active = active

    def release(self) -> None:
        """The render is over: its tiles are those of its film alone."""
        for state in self.states:
            state.held = state.active = None


def check_samples(settings: RenderSettings, sample_first: int) -> None:
    """Raises `RayBatchError` for samples that random numbers have no place for."""
    end = sample_first + settings.sample_count
    if sample_first < 0 or end > 2**32:
        raise RayBatchError(f"samples {sample_first} to {end} are out of range: use 0 to 2^32")
    if settings.is_adaptive and end > INT_MAX:
        raise RayBatchError(
            f"samples {sample_first} to {end} are out of range with adaptive sampling: use 0 to 2^31 - 1, or set "
            "adaptive_sampling to OFF"
        )


def film_to_fill(
    frame: Frame, settings: RenderSettings, sample_first: int, resume: Film | None, device: wp.Device
) -> Film:
    """An empty film, or a copy of the one to go on with, its tiles on `device`; raises `RayBatchError` for a film that
    cannot be gone on with, and for one that does not fit in memory.
    """
    _check_memory(frame, settings.half_count, device)
    film = Film.empty(frame, settings.half_count)
    if resume is None:
        return film
    if resume.complete:
        raise RayBatchError(
            "this film is complete: there is nothing to resume; to add samples, render a range with sample_first and "
            "merge"
        )
    state: ResumeState | None = resume.resume_state
    if state is None:
        raise RayBatchError("this film cannot be resumed: rays were given up when it was cancelled; render it again")
    if state.sample_first != sample_first or state.estimator != estimator_settings(settings):
        raise RayBatchError(
            "this film was begun with other settings or another range of samples; resume it with the same ones"
        )
    tiles = []
    for halves in state.tiles:
        tile = halves[0].tile
        held = resume.tile_on(tile.box, device)
        film.add_tile(held)
        parts = held.halves or (held,)
        tiles.append(
            tuple(
                TileState(tile, old.items_begun, half=old.half, held=part)
                for old, part in zip(halves, parts, strict=True)
            )
        )
    film.resume_state = ResumeState(
        tiles=tiles,
        sample_first=state.sample_first,
        sample_order=state.sample_order,
        estimator=state.estimator,
        policy=state.policy,
        done=state.done,
        end=state.end,
        active=state.active and state.active.copy(),
        invalid_samples=state.invalid_samples,
    )
    if film.resume_state.active:
        film.resume_state.list_active(device)
    return film


def _check_memory(frame: Frame, half_count: int, device: wp.Device) -> None:
    """Raises `OutOfMemoryError` where the film does not fit on `device`, or its pictures not in the host's memory."""
    host = wp.get_device("cpu")
    sums, pictures = film_bytes(frame, half_count)
    for where, needed in [(host, sums + pictures)] if device.is_cpu else [(device, sums), (host, pictures)]:
        if needed > (free := free_memory(where)):
            x0, y0, x1, y1 = frame.region
            raise OutOfMemoryError(
                f"a picture of {x1 - x0:,} x {y1 - y0:,} pixels with its passes takes {size_text(needed)} on "
                f"{where.alias}, where {size_text(free)} are free; lower the resolution, ask for fewer passes, or "
                "render it in parts with a render border"
            )


def estimator_settings(settings: RenderSettings) -> dict[str, Any]:
    """The settings that change the film's sums, but for what a clock decides."""
    return {
        name: getattr(settings, name)
        for name, info in SETTINGS.items()
        if info.effect == "estimator" and name not in _NO_SUMS
    }
