"""Films of one scene under many schedules, compared with the plain one to the last bit."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from checking.schedules import DrawnSizes, Draws, drawn_schedule, part_to_render
from raybatch_addon.core.bvh.memory import GeometrySize
from raybatch_addon.core.errors import OutOfMemoryError, SettingsError
from raybatch_addon.core.film import Film
from raybatch_addon.core.film.sums import WIDE_DIGITS, normalised
from raybatch_addon.core.scene.description import Frame, Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from raybatch_addon.core.shading.images.image_upload import device_bytes_of
from raybatch_addon.core.wavefront.tracers.buckets import tracer as batching

# What the engine says when a budget is too small; the number is taken at its word
_ENOUGH = re.compile(r"(?:about |; )([\d,]+) (?:bytes )?are enough|needs ([\d,]+) at least")
_BUDGETS = ("texture_budget", "geometry_budget")
_FEW = ("CPU_RAYS_FEW", "CPU_SWEEP_FEW", "CUDA_RAYS_FEW", "CUDA_SWEEP_FEW")
_RAISES_MOST = 8  # of a budget
_DRAWS_MOST = 1000  # of a schedule that goes with what is fixed


@dataclass(frozen=True)
class ComparedFilm:
    """One schedule, and what came of it."""

    settings: dict[str, Any]  # that were drawn, the budget as it was rendered with
    region: tuple[int, int, int, int]
    differs: list[str]  # what is not as it should be; empty: all is well
    raised: int = 0  # times the budget was too small
    statistics: dict[str, Any] = dataclasses.field(default_factory=dict)
    rays_few: int | None = None  # as for `FilmComparer.compare`

    @property
    def method(self) -> str:
        """How rays met the scene."""
        tree = self.statistics.get("tree") or {}
        return "paged" if "pages" in tree else ("batched" if self.statistics.get("batching") else "unbatched")


class FilmComparer:
    """The plain film of a scene, and others beside it."""

    def __init__(self, session: Session, scene: Scene, estimator: RenderSettings, turns: int):
        """`estimator`: all schedule settings of it are as by default. `turns`: as for `part_to_render`."""
        self._session, self._scene, self._estimator, self._turns = session, scene, estimator, turns
        self.plain = session.render(scene, estimator.replace(batching="OFF"))
        self.sums = _by_pixel(self.plain)
        frame = scene.frame
        x0, y0, x1, y1 = frame.region
        triangles = scene.triangles_placed
        self.sizes = DrawnSizes(
            triangles,
            max(1, GeometrySize.of(scene).tree_bytes_most(session.layout)),
            (x1 - x0) * (y1 - y0) * estimator.sample_count,
            device_bytes_of(scene.images),
        )

    def compare_drawn(
        self, draws: Draws, fixed: dict[str, Any] | None = None, keep_errors: bool = False
    ) -> ComparedFilm:
        """Render under a schedule that is drawn, but for what is `fixed`. With `keep_errors` what is raised counts as a
        difference.
        """
        drawn = self._legal(draws, fixed or {})
        frame = part_to_render(draws, self._scene.frame, self._estimator.replace(**drawn), self._turns)
        few = draws.pick((None, 0))
        return self._tried(drawn, frame, few) if keep_errors else self.compare(drawn, frame, few)

    def _legal(self, draws: Draws, fixed: dict[str, Any]) -> dict[str, Any]:
        """What is drawn is legal, but may not go with what is fixed; raises `SettingsError` where nothing does."""
        for left in reversed(range(_DRAWS_MOST)):
            drawn = {**drawn_schedule(draws, self.sizes), **fixed}
            try:
                self._estimator.replace(**drawn)
                break
            except SettingsError:
                if not (fixed and left):
                    raise
        return drawn

    def _tried(self, schedule: dict[str, Any], frame: Frame, rays_few: int | None) -> ComparedFilm:
        try:
            return self.compare(schedule, frame, rays_few)
        except SettingsError:
            raise
        except Exception as error:
            return ComparedFilm(schedule, frame.region, [f"{type(error).__name__}: {error}"], rays_few=rays_few)

    def compare(
        self, schedule: dict[str, Any], frame: Frame | None = None, rays_few: int | None = None
    ) -> ComparedFilm:
        """Render under `schedule`. A budget that is too small is raised to what the message says. `rays_few`: with
        fewer rays in every bucket they go on unbatched; None: as it is outside of checks, where that is most of a small
        film."""
        schedule, frame, raised = dict(schedule), frame or self._scene.frame, 0
        scene = dataclasses.replace(self._scene, frame=frame)
        while True:
            try:
                with _few(rays_few):
                    film = self._session.render(scene, self._estimator.replace(**schedule))
                break
            except OutOfMemoryError as error:
                found = _ENOUGH.search(str(error))
                enough = int(next(filter(None, found.groups())).replace(",", "")) if found else 0
                budget = next((name for name in _BUDGETS if name in str(error)), _BUDGETS[-1])
                if raised == _RAISES_MOST or enough <= schedule.get(budget, 0):
                    return ComparedFilm(schedule, frame.region, [f"refused: {error}"], raised, rays_few=rays_few)
                schedule[budget] = enough
                raised += 1
        return ComparedFilm(schedule, frame.region, self.faults(film), raised, film.statistics, rays_few)

    def simplest(self, found: ComparedFilm) -> dict[str, Any]:
        """The settings of `found` that differ from the defaults, and cannot be left at them without that all is
        well.
        """
        kept = {name: value for name, value in found.settings.items() if value != SETTINGS[name].default}
        x0, y0, x1, y1 = found.region
        frame = dataclasses.replace(self._scene.frame, border=(x0, y0, x1, y1))
        for name in sorted(kept):
            fewer = {other: value for other, value in kept.items() if other != name}
            with contextlib.suppress(SettingsError):
                if self._tried(fewer, frame, found.rays_few).differs:
                    kept = fewer
        return kept

    def faults(self, film: Film) -> list[str]:
        """What is not as it should be in `film`, of the whole frame or a part of it; an empty list where all is
        well.
        """
        statistics, faults = film.statistics, []
        x0, y0, x1, y1 = film.region
        left, bottom = self.plain.region[:2]
        part = (slice(y0 - bottom, y1 - bottom), slice(x0 - left, x1 - left))
        if not film.complete or statistics["invalid_samples"]:
            faults.append("the film is not complete, or has invalid samples")
        if film.passes.keys() != self.plain.passes.keys():
            return [*faults, "other passes"]
        for name, values in film.passes.items():
            expected = self.plain.passes[name][part]
            if not _same_bits(values, expected):
                count = int((values != expected).any(-1).sum())
                faults.append(f"pass {name}: {count:,} of {(x1 - x0) * (y1 - y0):,} pixels differ")
        sums = _by_pixel(film)
        if not np.array_equal(sums, self.sums[:, part[0], part[1]]):
            faults.append("exact sums differ")
        if not np.array_equal(film.counts.reshape(y1 - y0, x1 - x0), self.plain.counts.reshape(self.plain.shape)[part]):
            faults.append("counts of samples differ")
        waited, rays = statistics["batching"], statistics["rays"]["total"]
        if waited and not waited["rays"] == waited["finished"] == rays:
            faults.append(f"of {rays:,} rays {waited['rays']:,} were taken in, and {waited['finished']:,} finished")
        return faults


@contextlib.contextmanager
def _few(rays: int | None) -> Iterator[None]:
    kept = {name: getattr(batching, name) for name in _FEW}
    try:
        for name, value in kept.items():
            setattr(batching, name, value if rays is None else rays)
        yield
    finally:
        for name, value in kept.items():
            setattr(batching, name, value)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


def _by_pixel(film: Film) -> np.ndarray:
    """All digits of the exact sums, the wide ones (0 where there are none) behind those of the window; shape [digits,
    height, width, channels].
    """
    sums, shape = film.sums, (*film.shape, film.layout.count)
    wide = sums.wide if len(sums.wide) else np.zeros((WIDE_DIGITS, sums.window.shape[1]), np.int64)
    return np.concatenate([normalised(each).reshape(len(each), *shape) for each in (sums.window, wide)])
