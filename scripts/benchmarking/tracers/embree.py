"""Intel's Embree as a peer on the CPU, through the package embreex."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import time

import numpy as np
import warp as wp
from lib.command import UsageError

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene
from benchmarking.timing import seconds_of, slices
from benchmarking.tracers.interface import Hits, MeasuredTracer, Timing, Tree
from raybatch_addon.core.scene.description import Visibility

PACKAGE = "embreex"


def embree_version() -> str | None:
    """Version of the package, whose first three numbers are Embree's own; None where it is not installed."""
    return importlib.metadata.version(PACKAGE) if importlib.util.find_spec(PACKAGE) else None


class EmbreeTracer(MeasuredTracer):
    """One ray a call of `rtcIntersect1` or `rtcOccluded1`, in a loop in compiled code; `robust` is Embree's watertight
    mode.
    """

    def __init__(self, robust: bool):
        self.name = "embree-robust" if robust else "embree"
        self._robust = robust
        self._device = wp.get_device("cpu")

    def build(self, scene: BenchmarkScene) -> Tree:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        if scene.instancing or len(scene.flat.merged) != 1 or scene.flat.merged[0].visibility != int(Visibility.ALL):
            raise UsageError(
                f"{scene.name} has instances, or objects that some rays do not see, and {self.name} measures neither: "
                "leave it out of --tracers"
            )
        start = time.perf_counter()
        self._scene = EmbreeScene(robust=self._robust)
        TriangleMesh(self._scene, scene.flat.positions, scene.flat.triangles)
        # the tree is built when the first ray is traced
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        return Tree(time.perf_counter() - start, None)

    def load(self, rays: CapturedRays, thread_count: int) -> None:
        self._rays = rays
        query = "OCCLUDED" if rays.type.shadow else "INTERSECT"
        self._tasks = []
        self._found: dict[int, np.ndarray] = {}
        for part in slices(len(rays), thread_count):

            def run(
                first=part.start, origin=rays.origin[part], direction=rays.direction[part], t_max=rays.t_max[part]
            ) -> None:
                self._found[first] = self._scene.run(origin, direction, t_max, query=query)

            self._tasks.append(run)

    def trace(self) -> Timing:
        return Timing(seconds_of(self._tasks, self._device))

    def hits(self) -> Hits:
        hit = np.concatenate([self._found[first] for first in sorted(self._found)]) >= 0
        if self._rays.type.shadow:
            return Hits(hit, None)
        # the timed query gives triangles alone; this one writes distances over the limits that it is given
        t = self._scene.run(self._rays.origin, self._rays.direction, self._rays.t_max.copy(), query="DISTANCE")
        return Hits(hit, t)
