"""How the rays of a render are traced, as far as that is known before its scene is built."""

from __future__ import annotations

from dataclasses import dataclass

from ...bvh.node import Layout
from ...measure.counters import CounterFeatures
from ...scene.features import SceneFeatures
from ...settings.settings import RenderSettings
from .plan import Method, TracingPlan

# Rays that wait: whether visits and times queued can be counted
WAITING_METHODS = (Method.BATCHED, Method.PAGED)


@dataclass(frozen=True)
class Tracing:
    """How rays are traced, as far as it is known before the scene is built."""

    layout: Layout | None  # of the tree; None: Warp's tree
    method: Method
    instancing: bool  # through a top level of many trees
    curves: bool = False  # past segments of curves
    moving: bool = False  # instances or vertices move

    @staticmethod
    def of(plan: TracingPlan, layout: Layout, features: SceneFeatures) -> Tracing:
        """For a scene with `features`; what is beyond memory is always many trees."""
        own = plan.method is not Method.REFERENCE
        many = features.instancing or plan.method is Method.PAGED
        return Tracing(layout if own else None, plan.method, many, features.curves, features.moving)

    @property
    def waits(self) -> bool:
        """Whether rays wait for others."""
        return self.method in WAITING_METHODS

    def sort_mode(self, settings: RenderSettings) -> str:
        """The setting `ray_sort` as far as it is of use: OFF where rays are never sorted. Queues keep the order in
        which rays come, and measure nothing; of rays that wait for pages the order is that of their slots."""
        streams = settings.schedule == "STREAMING"  # each ray goes its way
        if streams or self.method is Method.PAGED or (self.waits and settings.ray_sort == "AUTO"):
            return "OFF"
        return settings.ray_sort

    def counters(self, settings: RenderSettings, passes: tuple[str, ...]) -> CounterFeatures | None:
        """What is counted; None: nothing. Warp's tree does not report its steps."""
        return CounterFeatures.choose(settings.counters, passes, steps=self.layout is not None, batches=self.waits)
