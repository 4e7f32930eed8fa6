"""What one call of `Session.render` was asked for, and what is filled in while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .ahead.request import CompileRequest
from .observers import Progress, Tile
from .scene.description import Scene
from .scene.features import SceneFeatures
from .settings.settings import RenderSettings
from .wavefront.plan.plan import Choice, TracingPlan
from .wavefront.render.rendering import Rendering, SnapshotWatcher
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
    started: float
    warnings: list[str]
    # filled while the render runs
    seconds: dict[str, float] = field(default_factory=dict)  # by stage
    hardware: dict[str, Any] = field(default_factory=dict)  # counts of the processor
    chosen: dict[str, Choice] = field(default_factory=dict)  # for settings that were left open until the scene was read
    path_bytes: int = 0  # device memory of one path alive, with all that grows with their number
    rendering: Rendering | None = None  # from the first ray on

    @property
    def request(self) -> CompileRequest:
        """The kernels of the render."""
        return CompileRequest(self.features, self.settings, self.plan, self.tier.shading)

    @property
    def marks(self) -> list[int]:
        """Sample counts at which pictures are wanted."""
        return [mark for watcher in self.watchers for mark in watcher.marks]
