"""The request of one call of `Session.render`, and what is filled in while it runs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import warp as wp

from .ahead.change import TierChange
from .ahead.request import CompileRequest
from .bvh.memory import GeometrySize
from .checkpoint.checkpoint import Checkpoint
from .device.devices import memory_used, worker_count
from .film import Film
from .measure.batching import batching_statistics
from .measure.parts import Parts
from .measure.statistics import render_statistics
from .observers import Cancel, Progress, Tile
from .programs.footprints import image_statistics
from .scene.description import Scene
from .scene.features import SceneFeatures
from .scene.notice import by_weight, described
from .settings.settings import RenderSettings
from .wavefront.adaptive.active_pixels import ActivePixels
from .wavefront.adaptive.ranges import first_active
from .wavefront.integrator import TileIntegrator
from .wavefront.plan.plan import Choice, Method, TracingPlan, report_of
from .wavefront.render.events import SnapshotWatcher
from .wavefront.render.rendering import Rendering
from .wavefront.render.resume import ResumeState
from .wavefront.render.rounds import RoundPolicy
from .wavefront.render.steps import TileParts, TileSteps
from .wavefront.render.summary import (
    batching_totals,
    device_shares,
    ray_totals,
    rounds_summary,
    tile_totals,
    volume_counts,
    workers_summary,
)
from .wavefront.scene.device_scene import DeviceScene
from .wavefront.scheduler import round_tile_edge, serves_many, step_tile_edge, tile_edge
from .wavefront.tier import TierChoice


@dataclass(kw_only=True)
class Job:
    """The request of one call of `render`; of a device beside the first with its own plan."""

    scene: Scene
    settings: RenderSettings
    features: SceneFeatures
    size: GeometrySize
    tier: TierChoice
    plan: TracingPlan
    sample_first: int
    on_tile: Callable[[Tile], None]
    on_progress: Callable[[Progress], None]
    cancelled: Callable[[], bool | Cancel]
    watchers: list[SnapshotWatcher]
    parts: Parts
    warnings: list[str]
    checkpoint: Checkpoint | None = None
    # filled while the render runs
    hardware: dict[str, Any] = field(default_factory=dict)  # counts of the processor
    chosen: dict[str, Choice] = field(default_factory=dict)  # for settings that were left open until the scene was read
    path_bytes: int = 0  # device memory of one path alive, with all that grows with their number
    rendering: Rendering | None = None  # from the first ray on
    change: TierChange | None = None  # of a render that general kernels begin, and others may take over

    def show(self, film: Film) -> None:
        """Hand out what `film` has already."""
        for tile in film.tiles.values():
            if tile.sample_count:
                self.on_tile(Tile(tile.x, tile.y, tile.width, tile.height, tile.passes))

    def begin(self, film: Film, after: Film | ActivePixels | None, devices: Sequence[wp.Device]) -> ResumeState:
        """The state of a render on `devices` that begins, or that goes on with what `film` has; `film` loses it
        meanwhile.
        """
        state, film.resume_state = film.resume_state, None
        if state is None:
            state = self._all_tiles(after, devices)
        else:
            state.policy = state.policy.resumed(self.settings, self.marks)
            if state.policy.is_cut and not state.shorten_round() and self.settings.time_limit:
                self.warnings.append(state.cannot_shorten)
        if self.settings.sample_order != state.sample_order:  # items are numbered by it
            self.settings = self.settings.replace(sample_order=state.sample_order)
        return state

    def _all_tiles(self, after: Film | ActivePixels | None, devices: Sequence[wp.Device]) -> ResumeState:
        """The state of a render that begins."""
        device = devices[0]
        settings, policy = self.settings, RoundPolicy.of(self.settings, self.marks, self.sample_first)
        active = first_active(self.scene.frame, settings, self.sample_first, after, device)
        x0, y0, x1, y1 = self.scene.frame.region
        workers = sum(worker_count(each, settings.thread_count) for each in devices)
        many = self._serves_many(device)
        choose_edge = step_tile_edge if self.steps else round_tile_edge if policy.is_cut else tile_edge
        edge = choose_edge(settings, device.is_cuda, x1 - x0, y1 - y0, workers, many)
        if not settings.tile_size:
            self.chosen["tile_size"] = Choice(edge, "by device, frame and samples")
        state = ResumeState.begin(settings, self.scene.frame, edge, self.sample_first, policy, active)
        if active:
            state.list_active(device)
        return state

    def statistics(
        self,
        film: Film,
        state: ResumeState,
        integrators: list[TileIntegrator],
        modules: Iterable[str],
        device_scene: DeviceScene | None,
        devices: Sequence[wp.Device],
    ) -> dict[str, Any]:
        """The report of the render on `devices`, which is over (`docs/statistics.md`); times in seconds, memory in
        bytes. `device_scene`: the scene on the first of them.
        """
        self.warnings += self.rendering.warnings if self.rendering else []
        invalid = state.invalid_samples
        if invalid:
            self.warnings.append(
                f"{invalid:,} samples were not finite and count as black; this is a fault, please report the scene"
            )
        rays, in_volumes = ray_totals(integrators), volume_counts(integrators)
        self.warnings += in_volumes.warnings(rays["camera"]) if in_volumes else []
        tiles = tile_totals(integrators)
        self.warnings += tiles.warnings() if tiles else []
        return render_statistics(
            devices=devices,
            shares=device_shares(devices, integrators),
            settings=self.settings,
            features=self.features,
            frame={"width": film.width, "height": film.height, "region": [*film.region], "passes": [*film.pass_names]},
            seconds=self.parts.record(),
            rays=rays,
            samples=film.sample_total,
            counts={
                "kernels": self.kernels,
                **workers_summary(integrators, device_scene, self.hardware, self.path_bytes),
                **batching_statistics(batching_totals(integrators), report_of({**self.plan.choices, **self.chosen})),
                **rounds_summary(film, state, None if self.rendering is None else self.rendering.error_report()),
                "triangles": self.scene.triangles_placed,
                "instances": len(self.scene.instances),
                "lights": len(self.scene.lights),
                "images": image_statistics(self.scene, device_scene.images if device_scene else None)
                | ({"tiles": tiles.report()} if tiles else {}),
                "invalid_samples": invalid,
                "volumes": in_volumes and in_volumes.report(),
                "modules": sorted(set(modules)),
                "warnings": self.warnings,
                "checkpoint": self.checkpoint and self.checkpoint.statistics,
                "missing": [described(notice) for notice in by_weight(self.scene.warnings)],
            },
        )

    @property
    def request(self) -> CompileRequest:
        """The kernels of the render."""
        return CompileRequest(self.features, self.settings, self.plan, self.tier.shading)

    @property
    def path_total(self) -> int:
        """Paths of the whole render at most."""
        return self.settings.sample_count * self.scene.frame.pixel_count

    @property
    def marks(self) -> list[int]:
        """Sample counts at which pictures are wanted."""
        return [mark for watcher in self.watchers for mark in watcher.marks]

    @functools.cached_property
    def steps(self) -> TileSteps | None:
        """How far tiles go before they are shown; None: as far as they can. Pages of geometry serve all samples at
        once.
        """
        settings, paged = self.settings, self.plan.method is Method.PAGED
        wanted = settings.tile_order == "PROGRESSIVE" and settings.sample_order == "FRAME_FIRST" and not paged
        return TileSteps() if wanted else None

    def _serves_many(self, device: wp.Device) -> bool:
        """Whether what is brought to `device` is to serve many rays."""
        return serves_many(self.plan.method is Method.PAGED, bool(self.features.fetch_program), device.is_cuda)

    def tile_parts(self, devices: Sequence[wp.Device]) -> TileParts | None:
        """Where several CUDA `devices` are to come to the end together; None: tiles are not rendered in parts, but in
        steps or whole. What is brought in, as pages of geometry are, serves all samples at once.
        """
        several = len(devices) > 1 and all(each.is_cuda for each in devices)
        whole = self.steps or self._serves_many(devices[0]) or self.settings.sample_order != "FRAME_FIRST"
        return TileParts() if several and not whole else None

    @property
    def kernels(self) -> dict[str, Any]:
        """Which kernels render, for the statistics."""
        changed_after = self.change.changed_after if self.change else None
        whys = [self.tier.why, self.change.why if self.change else ""]
        return {
            "tier": "GENERAL" if self.tier.general else "SPECIALISED",
            "why": "; ".join(why for why in whys if why),
            "specialised_after": None if changed_after is None else round(changed_after, 6),
            "compiled_for_next": self.change is not None and self.change.compiled_for_next,
        }

    @property
    def kernels_now(self) -> str:
        """Which kernels render now: general or specialised."""
        kernels = self.kernels
        return "general" if kernels["tier"] == "GENERAL" and kernels["specialised_after"] is None else "specialised"


def progress_of(
    parts: Parts,
    settings: RenderSettings,
    devices: Sequence[wp.Device],
    stage: str,
    *,
    fraction: float = 0.0,
    message: str = "",
    **rates: Any,
) -> Progress:
    """How far a render on `devices` has come; `rates`: what else is known (`Progress`)."""
    memory, peak = map(sum, zip(*map(memory_used, devices), strict=True))
    unknown = {"samples_done": 0.0, "rays_per_second": 0.0, "seconds_left": None}
    return Progress(
        stage=stage,
        fraction=fraction,
        samples_total=settings.sample_count,
        seconds_elapsed=parts.elapsed,
        memory_bytes=memory,
        memory_peak=peak,
        message=message or parts.message,
        **{**unknown, **rates},
    )
