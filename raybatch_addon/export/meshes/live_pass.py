"""A pass over a viewport's depsgraph in slices: it stops when a callback has taken long, and goes on in the next.

Between callbacks nothing of Blender's is kept. The pass goes on behind as many items of the depsgraph's list as it had
taken, which are the same as long as nothing is evaluated anew; where something is, it begins again.
"""

from __future__ import annotations

import time

import bpy

from .instances import PlacementCollector
from .kept_meshes import end_export
from .live_meshes import LiveMeshes
from .placements import Placements


class LivePass:
    """The pass under way, if there is one."""

    def __init__(self, meshes: LiveMeshes) -> None:
        self._meshes = meshes
        self._collector: PlacementCollector | None = None
        self._taken = 0  # items

    @property
    def is_under_way(self) -> bool:
        """Whether a pass stopped before its end."""
        return self._collector is not None

    def drop(self) -> None:
        """The next slice begins anew."""
        if self._collector is not None:
            self._collector = None
            self._meshes.end(is_whole=False)

    def go_on(
        self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, seconds: float
    ) -> Placements | None:
        """Take items of `depsgraph`, as `space` shows it, at least one and for `seconds`; all placements once there are
        no more. A slice also lasts as long as it took to find its first item, so that many items are no endless pass.
        """
        self._meshes.space = space
        try:
            return self._go_on(depsgraph, seconds)
        except BaseException:
            self.drop()
            raise
        finally:
            self._meshes.space = None
            if self._collector is not None:
                self._collector.look_away()

    def _go_on(self, depsgraph: bpy.types.Depsgraph, seconds: float) -> Placements | None:
        if self._collector is None:
            self._collector, self._taken = PlacementCollector(depsgraph, live=self._meshes), 0
        else:
            self._collector.look_at(depsgraph)
        first, start, end = self._taken, time.perf_counter(), 0.0
        for number, placed in enumerate(depsgraph.object_instances):
            if number < first:
                continue
            now = time.perf_counter()
            if number == first:
                end = now + max(seconds, now - start)
            elif now > end:
                return None
            self._collector.add(placed, _never)
            self._taken = number + 1
        placements = self._collector.finish()
        self._collector = None
        placements.materials.end_live()
        self._meshes.end(is_whole=True)
        end_export()
        return placements


def _never() -> bool:
    return False
