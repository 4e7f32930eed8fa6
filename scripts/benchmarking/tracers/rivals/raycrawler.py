"""RayCrawler, the scheme that RayBatch follows, with its own parameters."""

from __future__ import annotations

from pathlib import Path

import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.tracers.batching import Budget, WaitingTracer
from benchmarking.tracers.stages import SceneTrees
from raybatch_addon.core.rays import RayKind, RayList
from raybatch_addon.core.settings.presets import preset_settings
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tracers.interface import Tracer

FEWEST_LEFT = 0.75  # of the rays alive: new ones are begun when fewer are left


class RayCrawlerTracer(WaitingTracer):
    """Rays wait in queues at treelets: Gasparian and Bikker 2016, as the thesis "Batching of divergent rays" tells it
    in chapters 2 and 3.

    This is `on` with the thesis's settings: a top level that is left where a child would have fewer nodes than the
    treelet size, or at depth 15; an entry and an exit queue a treelet; the fullest bucket next; rays that go on through
    the top level each by itself; rays held by value. As in the original a limited number of rays is alive, and new ones
    are begun when few are left. What differs: nodes have eight children instead of four, inside a treelet a thread
    carries 16 rays at a time, as it does in `off`, and with fewer than 16 rays in every bucket rays go on unbatched.
    """

    def __init__(
        self, name: str, trees: SceneTrees, device: wp.Device, settings: RenderSettings, values: dict[str, int | str]
    ):
        """`values`: `treelet`, nodes; `queue`, rays; `rays` alive; `storage`."""
        thesis = preset_settings("THESIS")
        one_warp = {"warp_count", "register_cap"}  # of its GPU program
        chosen = {each: value for each, value in thesis.items() if each not in one_warp}
        chosen |= {
            "treelet_size": values["treelet"],
            "treelet_size_min": values["treelet"],
            "queue_size": values["queue"],
            "ray_storage": str(values["storage"]).upper(),
        }
        super().__init__(name, trees, device, settings.replace(**chosen), Budget(0, Path()))
        self._alive = int(values["rays"])

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        super().load(rays, thread_count)
        self._waiting = []
        few = max(1, round(self._alive * (1 - FEWEST_LEFT)))
        first, step = 0, min(self._alive, self._count)
        while first < self._count:
            end = min(self._count, first + step)
            count = wp.array([end - first], dtype=int, device=self._device)
            self._waiting.append(RayList(self._listed.slots[first:end], count, end - first))
            first, step = end, few

    def _run(self, tracer: Tracer) -> None:
        kind = RayKind.OCCLUSION if self._any_hit else RayKind.CLOSEST
        before, begun = tracer.totals().finished, 0
        waiting = list(reversed(self._waiting))
        while (finished := tracer.totals().finished - before) < self._count:
            while waiting and begun - finished + waiting[-1].bound <= self._alive:
                begun += waiting[-1].bound
                tracer.submit(kind, waiting.pop())
            tracer.advance()
            tracer.take_finished()
