"""A session whose device is a cluster: it renders as `Session` does, and returns the same film."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from ..checkpoint.checkpoint import Checkpoint
from ..errors import SettingsError
from ..film import Film
from ..measure.parts import Parts
from ..measure.statistics import ENGINE, versions
from ..observers import Progress, RenderObserver, Tile, call_all
from ..scene.description import Scene
from ..scene.notice import by_weight, described
from ..scene.validate import checked_scene
from ..settings.settings import RenderSettings
from .connection import Connection
from .keeping import ClusterKeeper
from .parts import parts_of
from .render import ClusterJob, ClusterRender

# Settings that need all samples so far in one place while a render goes on, and what they are without that
_IN_ONE_PLACE = {"adaptive_sampling": "OFF", "error_target": 0.0, "time_limit": 0.0}
_POLL_SECONDS = 0.05


class ClusterSession:
    """Renders on the workers of a Dask cluster, whose devices are of one model."""

    def __init__(self, connection: Connection, report: Callable[[str], None] = lambda text: None):
        """`connection` stays the caller's; `report` gets notes."""
        self._connection, self._report = connection, report

    def close(self) -> None:
        """Nothing is kept here; machines keep their parts of scenes for later renders."""

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
        """As `Session.render`; pictures come as one tile that is the whole frame, every few seconds.

        Raises `SettingsError` for settings that need all samples in one place, and `ClusterError`.
        """
        for name, off in _IN_ONE_PLACE.items():
            if getattr(settings, name) != off:
                raise SettingsError(f"{name} needs all samples in one place; set it to {off} to render on a cluster")
        if resume is not None or after is not None:
            raise SettingsError("films in memory are not gone on with on a cluster; give a checkpoint")
        parts = parts or Parts("check")
        parts.enter("check")
        checked = checked_scene(scene)
        keeper = ClusterKeeper(sample_first, *((checkpoint.path, checkpoint.interval) if checkpoint else ()))
        keeper.begin(scene, settings, self._report)
        job = ClusterJob(parts_of(scene, settings), sample_first, sample_first + settings.sample_count)
        x0, y0, x1, y1 = scene.frame.region
        show = call_all(on_progress, [each.on_progress for each in observers])
        show_tile = call_all(on_tile, [each.on_tile for each in observers])
        is_cancelled = cancelled or (lambda: False)
        parts.enter("start")
        render = ClusterRender(self._connection, job, keeper)
        started = time.perf_counter()
        try:
            while not render.is_over and not is_cancelled():
                render.step(is_cancelled)
                for passes in render.take_pictures():
                    show_tile(Tile(x0, y0, x1 - x0, y1 - y0, passes))
                if render.is_rendering and parts.part != "render":
                    parts.enter("render")
                show(_progress(render, settings, parts, time.perf_counter() - started))
                time.sleep(_POLL_SECONDS)
        finally:
            render.close()
            keeper.wait()
        parts.enter("report")
        film = Film.empty(scene.frame, settings.half_count) if keeper.film is None else keeper.film.film()
        film.complete = render.is_over
        film.statistics = _statistics(film, scene, settings, keeper, render, parts)
        film.statistics["warnings"] = [*map(str, checked.warnings), *film.statistics["warnings"]]
        if film.complete:
            show_tile(Tile(x0, y0, x1 - x0, y1 - y0, film.passes))
        return film


def _progress(render: ClusterRender, settings: RenderSettings, parts: Parts, seconds: float) -> Progress:
    done, slots = render.samples_done, sum(each.slots for each in render.workers)
    fraction = min(max(done / settings.sample_count, 0.0), 1.0)
    left = seconds / fraction - seconds if fraction > 0.01 else None
    message = f"Rendering on {slots} workers" if slots else "Waiting for workers of the cluster"
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


def _statistics(
    film: Film, scene: Scene, settings: RenderSettings, keeper: ClusterKeeper, render: ClusterRender, parts: Parts
) -> dict[str, Any]:
    """The report: what is known of renders on a cluster, and who rendered which samples (docs/statistics.md)."""
    shares = sorted(keeper.shares, key=lambda each: each["first"])
    rays = {kind: sum(each["rays"][kind] for each in shares) for kind in ("camera", "bounce", "shadow", "total")}
    seconds = parts.record()
    devices = {(each["worker"], each["device"]["alias"]): each["device"] for each in shares}
    warnings = dict.fromkeys(text for each in shares for text in each["warnings"])
    invalid = keeper.film.progress.invalid_samples if keeper.film else 0
    return {
        "engine": ENGINE,
        "versions": versions(),
        "device": shares[0]["device"] if shares else None,
        "devices": [*devices.values()],
        "settings": asdict(settings),
        "frame": {"width": film.width, "height": film.height, "region": [*film.region], "passes": [*film.pass_names]},
        "seconds": seconds,
        "samples": film.sample_total,
        "rays": rays,
        "rays_per_second": round(rays["total"] / seconds["render"]) if seconds["render"] else 0,
        "memory_peak": {of: max((each["memory_peak"][of] for each in shares), default=0) for of in ("host", "device")},
        "complete": film.complete,
        "stopped_by": "samples" if film.complete else None,
        "samples_per_pixel": keeper.end - (shares[0]["first"] if shares else keeper.end),
        "error": None,
        "invalid_samples": invalid,
        "warnings": [*warnings, *keeper.warnings],
        "missing": [described(notice) for notice in by_weight(scene.warnings)],
        "cluster": {
            "shares": [
                {name: each[name] for name in ("first", "end", "worker", "seconds", "seconds_rendering")}
                | {"device": each["device"]["name"]}
                for each in shares
            ],
            "tasks_again": render.tasks_again,
        },
    }
