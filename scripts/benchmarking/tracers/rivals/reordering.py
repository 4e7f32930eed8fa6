"""Rivals that reorder rays before they are traced as those of `off` are. The time to reorder is part of theirs."""

from __future__ import annotations

import dataclasses

import numpy as np
import warp as wp

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.tracers.interface import Tree
from benchmarking.tracers.rivals.key_sort import Key, KeySorter, key_sort_kernel
from benchmarking.tracers.rivals.simplified import simplified_scene
from benchmarking.tracers.stages import SceneTrees, StageTracer
from raybatch_addon.core.bvh.traverse.options import TraceOptions
from raybatch_addon.core.device.devices import load_kernels
from raybatch_addon.core.rays import RayList, Rays
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.rays import allocate_rays
from raybatch_addon.core.wavefront.tracers.unbatched import TraceStage, trace_stage

KEYS = {
    "origin": Key.ORIGIN,
    "origin-direction": Key.ORIGIN_DIRECTION,
    "direction-origin": Key.DIRECTION_ORIGIN,
    "two-point": Key.TWO_POINT,
}


class KeyTracer(StageTracer):
    """Rays sorted by a key: Meister, Boksansky, Guthe and Bittner 2020, "On ray reordering techniques for faster GPU
    ray tracing".

    The keys are theirs by name: the origin; origin above direction; direction above origin; two points, of which the
    end is guessed. The layouts here: points as Morton codes within the scene's box, of 10, 6 or 5 bits an axis;
    directions as 14 bits on an unfolded octahedron; 30 or 32 bits in all, so that three passes sort them. Two points
    are interleaved bit by bit; the end is guessed at a share of the box's diagonal, or at t_max where that is nearer.
    Slots are sorted, rays stay where they are. (A key of octant and origin is the engine's own: `off-sorted`.)
    """

    def __init__(self, name: str, trees: SceneTrees, device: wp.Device, key: str, reach: int, traversal: str):
        """`reach`: percents of the diagonal; `traversal`: interleaved, as `off`, or plain, as `off-plain`."""
        super().__init__(name, trees, device, "OFF", sorts=True, plain=traversal == "plain")
        self._key, self._reach = KEYS[key], reach / 100

    def build(self, scene: BenchmarkScene) -> Tree:
        reported = super().build(scene)
        load_kernels([key_sort_kernel(self._device)], self._device, lambda done, total: None)
        return reported

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        super().load(rays, thread_count)
        low, high = np.asarray(self._box)
        reach = float(np.linalg.norm(high - low)) * self._reach
        for part in self._parts:
            part.sorter = KeySorter(part.listed.bound, self._device, self._key, self._box, reach)


class HitPointTracer(StageTracer):
    """Rays sorted by where they will hit: Moon, Byun, Kim, Claudio, Kim, Ban, Nam and Yoon 2010, "Cache-oblivious ray
    reordering".

    Rays are traced in a simplified scene first, and sorted along a space-filling curve by their hits there. The
    simplified scene here has its meshes' vertices clustered in cells (`simplified.py`), a tree as the scene's own, and
    is traced by the same kernel; a ray that hits nothing in it counts where it leaves the scene's box, or at t_max. The
    curve is Z-order, of 10 bits an axis. The whole list is reordered, not a buffer of rays. Building is not timed,
    tracing and sorting are. Any-hit rays look for their closest hit in the simplified scene too.
    """

    def __init__(
        self, name: str, trees: SceneTrees, device: wp.Device, settings: RenderSettings, cells: int, traversal: str
    ):
        """`cells` along the longest side of a mesh; `traversal` of the scene: see `KeyTracer`."""
        super().__init__(name, trees, device, "OFF", sorts=True, plain=traversal == "plain")
        self._cells = cells
        self._simple_trees = SceneTrees(device, settings)

    def build(self, scene: BenchmarkScene) -> Tree:
        reported = super().build(scene)
        self._simple = self._simple_trees.get(simplified_scene(scene, self._cells), "OFF")
        kernels = [*self._probe().kernels, key_sort_kernel(self._device)]
        load_kernels(kernels, self._device, lambda done, total: None)
        simple = self._simple.reported
        return Tree(reported.build_seconds + simple.build_seconds, reported.bytes + simple.bytes)

    def _probe(self) -> TraceStage:
        return trace_stage(self._layout, TraceOptions(any_hit=False, instancing=self._instancing))

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        super().load(rays, thread_count)
        self._probes = allocate_rays(len(rays), self._device)  # their hits; what they ask is the rays' own
        for name in ("origin", "direction", "t_max", "visibility"):
            setattr(self._probes, name, getattr(self._rays, name))
        for part in self._parts:
            sorter = KeySorter(part.listed.bound, self._device, Key.HIT_POINT, self._box)
            sorter.rule.hit, sorter.rule.hit_t = self._probes.hit_instance, self._probes.hit_t
            part.sorter = _ProbingSorter(self._probe(), self._simple.tree, self._probes, sorter)


@dataclasses.dataclass
class _ProbingSorter:
    """Traces rays in the simplified scene, and sorts them by what they hit there."""

    stage: TraceStage
    tree: object
    probes: Rays
    sorter: KeySorter

    def sort(self, rays: Rays, listed: RayList) -> RayList:
        """See `KeySorter.sort`."""
        self.stage.launch(self.tree, self.probes, listed, None)
        return self.sorter.sort(rays, listed)
