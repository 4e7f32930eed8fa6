"""The rays that every tracer of a worker works on."""

from __future__ import annotations

from dataclasses import dataclass, field

import warp as wp

from ...bvh.traverse.counts import TraceCounts
from ...measure.timing import NoTimer, StageTimer
from ...rays import RayKind, Rays


@dataclass(frozen=True, kw_only=True)
class WorkerRays:
    """The rays of a worker, and how tracing them is timed and counted."""

    rays: Rays
    path_count: int  # rays in slots below extend paths
    shadow_kind: RayKind  # kind of the rays in all other slots
    device: wp.Device
    timer: StageTimer | NoTimer = field(default_factory=NoTimer)
    counts: TraceCounts | None = None  # steps by ray slot; None: nothing is counted

    @property
    def slot_count(self) -> int:
        """Ray slots in all."""
        return self.rays.origin.size
