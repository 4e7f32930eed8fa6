"""What one call of `Session.render` was asked for, and what is filled in while it runs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import warp as wp

from .ahead.change import TierChange
from .ahead.request import CompileRequest
from .device.devices import memory_used
from .measure.parts import Parts
from .observers import Progress, Tile
from .scene.description import Scene
from .scene.features import SceneFeatures
from .settings.settings import RenderSettings
from .wavefront.plan.plan import Choice, Method, TracingPlan
from .wavefront.render.rendering import Rendering, SnapshotWatcher
from .wavefront.render.steps import TileSteps
from .wavefront.tier import TierChoice


@dataclass(kw_only=True)
class Job:
    """What one call of `render` was asked for."""

    scene: Scene
    settings: RenderSettings
    features: SceneFeatures
    tier: TierChoice
    plan: TracingPlan
    sample_first: int
    on_tile: Callable[[Tile], None]
    on_progress: Callable[[Progress], None]
    cancelled: Callable[[], bool]
    watchers: list[SnapshotWatcher]
    parts: Parts
    warnings: list[str]
    # filled while the render runs
    hardware: dict[str, Any] = field(default_factory=dict)  # counts of the processor
    chosen: dict[str, Choice] = field(default_factory=dict)  # for settings that were left open until the scene was read
    path_bytes: int = 0  # device memory of one path alive, with all that grows with their number
    rendering: Rendering | None = None  # from the first ray on
    change: TierChange | None = None  # of a render that general kernels begin, and others may take over

    @property
    def request(self) -> CompileRequest:
        """The kernels of the render."""
        return CompileRequest(self.features, self.settings, self.plan, self.tier.shading)

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

    @property
    def kernels(self) -> dict[str, Any]:
        """Which kernels render, for the statistics."""
        changed_after = self.change.changed_after if self.change else None
        return {
            "tier": "GENERAL" if self.tier.general else "SPECIALISED",
            "why": self.tier.why,
            "specialised_after": None if changed_after is None else round(changed_after, 6),
        }

    @property
    def kernels_now(self) -> str:
        """Which kernels render now: general or specialised."""
        told = self.kernels
        return "general" if told["tier"] == "GENERAL" and told["specialised_after"] is None else "specialised"


def progress_of(
    parts: Parts,
    settings: RenderSettings,
    device: wp.Device,
    stage: str,
    *,
    fraction: float = 0.0,
    message: str = "",
    **rates: Any,
) -> Progress:
    """How far a render on `device` has come; `rates`: what else is known (`Progress`)."""
    memory, peak = memory_used(device)
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
