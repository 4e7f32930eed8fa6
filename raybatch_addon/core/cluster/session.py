"""A session whose device is a cluster: it renders as `Session` does, and returns the same film."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from ..checkpoint.checkpoint import Checkpoint
from ..device.devices import load_kernels, start_warp
from ..errors import SettingsError
from ..film import Film
from ..measure.parts import Parts
from ..observers import Progress, RenderObserver, Tile, call_all
from ..scene.description import Scene
from ..scene.validate import checked_scene
from ..settings.settings import RenderSettings
from ..wavefront.adaptive.active_pixels import ADAPTIVE_KERNELS
from ..wavefront.render.resume import check_samples
from .bands import Region
from .connection import Connection
from .keeping import ClusterKeeper
from .parts import parts_of
from .render import ClusterRender
from .report.statistics import cluster_statistics
from .rounds import ClusterRounds
from .under_way import RendersUnderWay, UnderWay

_POLL_SECONDS = 0.05
# Renders that are begun, and not taken, hold their scene and what is there of their film
RENDERS_MOST = 4


def refuse_clock(settings: RenderSettings) -> None:
    """Raise `SettingsError` for settings that need the clock of one process."""
    if settings.time_limit:
        raise SettingsError(
            "time_limit ends a render by the clock of one process, and workers of a cluster do not come to their "
            "samples at the same time; set it to 0, or set error_target, or a number of samples"
        )


class PendingFilm:
    """A render on a cluster that goes on by itself."""

    def __init__(self, scene: Scene, settings: RenderSettings, keeper: ClusterKeeper, under_way: UnderWay):
        self._scene, self._settings, self._keeper, self._under_way = scene, settings, keeper, under_way
        self.warnings: list[str] = []  # about the scene
        self.is_taken = False  # nobody waits for it any more

    @property
    def is_done(self) -> bool:
        """Whether `film` does not wait."""
        return self._under_way.ended.is_set()

    def cancel(self) -> None:
        """Nobody wants it any more: its workers are free for others."""
        self._under_way.is_cancelled = self.is_taken = True

    def end(self) -> None:
        """Nobody waits for it any more, and its checkpoint has what is here. Waits for that."""
        self.cancel()
        self._under_way.ended.wait()
        self._keeper.finish()

    def film(
        self,
        *,
        on_tile: Callable[[Tile], None] | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
        observers: Sequence[RenderObserver] = (),
    ) -> Film:
        """Wait for it, before other renders of the session; raises what ended it. Arguments are as in `render`."""
        show = call_all(on_progress, [each.on_progress for each in observers])
        show_tile = call_all(on_tile, [each.on_tile for each in observers])
        own, render, settings = self._under_way, self._under_way.render, self._settings
        own.is_awaited = render.wants_pictures = True
        try:
            while not own.ended.is_set():
                if cancelled is not None and cancelled():
                    self.cancel()
                for region, passes in render.take_pictures():
                    show_tile(_tile(region, passes))
                show(_progress(render, settings, own.parts, time.perf_counter() - own.begun))
                own.ended.wait(_POLL_SECONDS)
        finally:
            self.is_taken = True
            if not own.ended.is_set():
                self.cancel()
            own.ended.wait()
            own.parts.enter("report")
            self._keeper.finish()
        if own.error is not None:
            raise own.error
        kept = self._keeper.film
        film = Film.empty(self._scene.frame, settings.half_count) if kept is None else kept.film()
        film.complete = render.is_over
        film.statistics = cluster_statistics(film, self._scene, settings, self._keeper, own)
        film.statistics["warnings"] = [*dict.fromkeys([*self.warnings, *film.statistics["warnings"]])]
        if film.complete:
            show(_progress(render, settings, own.parts, time.perf_counter() - own.begun))
            show_tile(_tile(render.rounds.region, film.passes))
        return film


class ClusterSession:
    """Renders on the workers of a Dask cluster, whose devices are of one model."""

    def __init__(self, connection: Connection, report: Callable[[str], None] = lambda text: None):
        """`connection` stays the caller's; `report` gets notes."""
        self._connection, self._report = connection, report
        self._under_way = RendersUnderWay(connection)
        self._pending: list[PendingFilm] = []

    def close(self) -> None:
        """End what is under way, whose checkpoints have what is here; machines keep their parts of scenes for later
        renders.
        """
        self._under_way.close()
        for each in self._pending:
            each.end()

    @property
    def has_room(self) -> bool:
        """Whether another render may begin before those that did are taken."""
        self._pending = [each for each in self._pending if not each.is_taken]
        return len(self._pending) < RENDERS_MOST

    def begin(
        self,
        scene: Scene,
        settings: RenderSettings,
        *,
        sample_first: int = 0,
        parts: Parts | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> PendingFilm:
        """Begin a render, which goes on beside what the caller does, and beside others: where one has no tasks left for
        a worker, the next one has. Its film is the same as that of `render`, whose arguments these are.

        Raises `SettingsError` for settings that need a clock, and `ClusterError`.
        """
        refuse_clock(settings)
        parts = parts or Parts("check")
        parts.enter("check")
        check_samples(settings, sample_first)
        checked = checked_scene(scene)
        start_warp()
        keeper = ClusterKeeper(sample_first, *((checkpoint.path, checkpoint.interval) if checkpoint else ()))
        keeper.begin(scene, settings, self._report)
        rounds = ClusterRounds(scene.frame, settings, sample_first, keeper.film)
        if rounds.active:  # looks are made on threads, which must find their kernels loaded
            load_kernels(ADAPTIVE_KERNELS, wp.get_device("cpu"), lambda done, count: None)
        parts.enter("start")
        render = ClusterRender(self._connection, parts_of(scene, settings), keeper, rounds)
        under_way = UnderWay(render, parts)
        self._under_way.add(under_way)
        pending = PendingFilm(scene, settings, keeper, under_way)
        pending.warnings = [*map(str, checked.warnings)]
        self._pending.append(pending)
        return pending

    def render(
        self,
        scene: Scene,
        settings: RenderSettings,
        *,
        on_tile: Callable[[Tile], None] | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
        observers: Sequence[RenderObserver] = (),
        sample_first: int = 0,
        resume: Film | None = None,
        after: Film | None = None,
        parts: Parts | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> Film:
        """As `Session.render`; every few seconds pictures come as tiles, bands of the frame, and at the end as one.

        Raises what `begin` does.
        """
        if resume is not None or after is not None:
            raise SettingsError("films in memory are not gone on with on a cluster; give a checkpoint")
        pending = self.begin(scene, settings, sample_first=sample_first, parts=parts, checkpoint=checkpoint)
        return pending.film(on_tile=on_tile, on_progress=on_progress, cancelled=cancelled, observers=observers)


def _tile(region: Region, passes: dict[str, np.ndarray]) -> Tile:
    x0, y0, x1, y1 = region
    return Tile(x0, y0, x1 - x0, y1 - y0, passes)


def _progress(render: ClusterRender, settings: RenderSettings, parts: Parts, seconds: float) -> Progress:
    done, left_out = render.samples_done, render.left_out
    slots = sum(each.slots for each in render.workers if each.host not in left_out)
    fraction = 1.0 if render.is_over else min(max(done / settings.sample_count, 0.0), 1.0)
    left = seconds / fraction - seconds if fraction > 0.01 else None
    message = f"Rendering on {slots} workers"
    if not slots:
        message = "; ".join(["Waiting for workers of the cluster", *filter(None, [left_out.why])])
    return Progress(
        stage="render" if render.is_rendering else "build",
        fraction=fraction,
        samples_done=done,
        samples_total=settings.sample_count,
        rays_per_second=render.rays / seconds if seconds else 0.0,
        seconds_elapsed=parts.elapsed,
        seconds_left=left,
        memory_bytes=0,
        memory_peak=0,
        message=message,
        seconds_rendering=seconds,
    )
