"""How far a render has come, as a file keeps it: the state of `core/wavefront/render/resume.py` without its sums."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..settings.settings import RenderSettings
from ..wavefront.adaptive.active_pixels import ActivePixels
from ..wavefront.render.resume import ResumeState, estimator_settings
from ..wavefront.render.rounds import RoundPolicy
from ..wavefront.scheduler import Rectangle
from ..wavefront.tile_state import TileState
from .samples import FilmPart


@dataclass(frozen=True, kw_only=True)
class KeptProgress:
    """How far a render has come."""

    tiles: tuple[tuple[int, int, int, int], ...]  # x, y, width, height in the frame [pixels]
    items_begun: tuple[tuple[int, ...], ...]  # of each tile, by half: paths of the round under way, all in the film
    sample_first: int
    sample_order: str
    done: int  # samples of every pixel at the end of the last round
    end: int | None  # the same at the end of the round that is under way; None: between rounds
    policy: dict[str, Any]  # what decides how the rounds to come go (`RoundPolicy.record`)
    invalid_samples: int
    threshold: float  # with adaptive sampling
    looks: tuple[dict[str, Any], ...]
    stopped: np.ndarray | None  # as `ActivePixels.stopped`; None: every pixel gets all samples

    @staticmethod
    def of(state: ResumeState) -> KeptProgress:
        """A copy of how far `state` has come."""
        active = state.active
        return KeptProgress(
            tiles=tuple((t.x, t.y, t.width, t.height) for t in (halves[0].tile for halves in state.tiles)),
            items_begun=tuple(tuple(each.items_begun for each in halves) for halves in state.tiles),
            sample_first=state.sample_first,
            sample_order=state.sample_order,
            done=state.done,
            end=state.end,
            policy=state.policy.record(),
            invalid_samples=state.invalid_samples,
            threshold=active.threshold if active else 0.0,
            looks=tuple(active.looks) if active else (),
            stopped=active.stopped.copy() if active else None,
        )

    @property
    def half_count(self) -> int:
        """The number of films in which the samples come: one, or two halves."""
        return len(self.items_begun[0])

    @property
    def is_between_rounds(self) -> bool:
        """Whether every pixel that gets samples has the same number of them."""
        return self.end is None or not any(map(any, self.items_begun))

    def record(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """The values as JSON has them, and arrays by name."""
        header = {name: value for name, value in vars(self).items() if name != "stopped"}
        return header, {} if self.stopped is None else {"stopped": self.stopped}

    @staticmethod
    def of_record(header: dict[str, Any], arrays: dict[str, np.ndarray], part: FilmPart) -> KeptProgress:
        """The inverse of `record`; raises `ValueError`, `TypeError` or `KeyError` for what is none."""
        tiles = tuple((int(x), int(y), int(width), int(height)) for x, y, width, height in header["tiles"])
        begun = tuple(tuple(map(int, halves)) for halves in header["items_begun"])
        covered = np.zeros(part.pixel_count, np.int64)
        if sum(width * height for _, _, width, height in tiles) == part.pixel_count:
            for tile in tiles:
                covered[part.pixels(*tile)] = 1
        if not covered.all() or len(begun) != len(tiles) or len({len(halves) for halves in begun}) != 1:
            raise ValueError("its tiles are not those of its frame")
        if len(begun[0]) not in (1, 2) or header["sample_order"] not in ("FRAME_FIRST", "PIXEL_FIRST"):
            raise ValueError("its rounds are none")
        stopped, (x0, y0, x1, y1) = arrays.get("stopped"), part.region
        if stopped is not None and (stopped.dtype != np.int32 or stopped.shape != (y1 - y0, x1 - x0)):
            raise ValueError("its pixels with adaptive sampling are not those of its frame")
        end = header["end"]
        return KeptProgress(
            tiles=tiles,
            items_begun=begun,
            sample_first=int(header["sample_first"]),
            sample_order=header["sample_order"],
            done=int(header["done"]),
            end=None if end is None else int(end),
            policy=dict(header["policy"]),
            invalid_samples=int(header["invalid_samples"]),
            threshold=float(header["threshold"]),
            looks=tuple(dict(look) for look in header["looks"]),
            stopped=stopped,
        )

    def state(self, settings: RenderSettings, region: tuple[int, int, int, int]) -> ResumeState:
        """The state of a render with `settings` that goes on from here; sums are those of its film."""
        active = None
        if self.stopped is not None:
            active = ActivePixels(region, self.threshold, self.stopped.copy(), list(self.looks))
        return ResumeState(
            tiles=[
                tuple(TileState(Rectangle(*tile), count, half=half) for half, count in enumerate(counts))
                for tile, counts in zip(self.tiles, self.items_begun, strict=True)
            ],
            sample_first=self.sample_first,
            sample_order=self.sample_order,
            estimator=estimator_settings(settings),
            policy=RoundPolicy.of_record(settings.sample_count, self.policy),
            done=self.done,
            end=self.end,
            active=active,
            invalid_samples=self.invalid_samples,
        )
