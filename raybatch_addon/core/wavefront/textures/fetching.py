"""Tiles of images for the loop of one worker: who asks for them, who waits, and when they are brought.

A turn has three parts: shadow rays that came back, or wait, are looked at, and go on where all of their tiles are
there; so do paths at surfaces, behind all stages that come before a surface is shaded; and at the end of the turn the
tiles are brought that were missing.

Some ray always goes on: among those that wait that of the least slot leads the next turn, in which all of its tiles are
marked, and stay or come before all others. A pool has slots for all that one ray may need, so the leader's are there a
turn later, on a GPU after some turns, but for those of look-ups whose coordinates were not known; these are marked
then, and a program has few of them.
"""

from __future__ import annotations

import warp as wp

from ...device.launches import RepeatedLaunches
from ...measure.timing import NoTimer, StageTimer
from ...native.structs import to_numpy
from ...rays import NO_RAYS, RayList, Rays
from ..path_lists import PathLists
from ..rays import Paths
from ..scene.device_scene import DeviceScene
from ..scene.shading_data import SceneData
from ..stages.limits import PathLimits
from ..stages.stage import stage_thread_count
from ..stages.work import TileWork
from .pool import TilePool, TileTotals
from .stage import choose_shadows_kernel, fetch_kernels, list_shadows_kernel, look_again_kernel, shadows_back_kernel
from .state import LEADER, LOOKED, NEXT_LEADER, NOBODY, WAIT_COUNTS, WAITED, WAITING_NOW, TextureWaits


class TileFetcher:
    """Lets the rays of one worker wait for tiles of images."""

    def __init__(self, scene: DeviceScene, path_count: int, slots: int, timer: StageTimer | NoTimer):
        """For `path_count` paths in `scene`, whose tiles have so many `slots`."""
        assert scene.images.tiled and scene.fetches
        device, source = scene.device, scene.images.tiled
        self._device, self._path_count, self._timer = device, path_count, timer
        self._pool = TilePool(source, slots)
        self._launches = RepeatedLaunches(device)
        self._surfaces, self._shadows, *_ = fetch_kernels(scene.features, scene.shading, device.is_cuda)
        # shadow rays that any hit ends look up nothing
        self.holds_shadows = bool(self._shadows) and scene.transparent_shadows
        self.data: SceneData = scene.data_with(self._pool.table)  # for the worker's stages
        self._waits = TextureWaits()
        self._waits.nodes = scene.fetches_with(self._pool.table)
        self._waits.phase = wp.zeros(path_count * (2 if self.holds_shadows else 1), dtype=int, device=device)
        self._waits.leader = wp.full(2, NOBODY, dtype=int, device=device)
        self._waits.counts = wp.zeros(WAIT_COUNTS, dtype=int, device=device)
        self._counted = wp.zeros(WAIT_COUNTS, dtype=int, device="cpu", pinned=device.is_cuda)
        self._waiting = 0  # rays that waited at the end of the last turn
        self._looked = self._waited = 0
        self._shadows_back = False  # some came back in this turn
        if self.holds_shadows:
            self._chosen, self._before, self._slots = (wp.zeros(path_count, dtype=int, device=device) for _ in range(3))
            self._count = wp.zeros(1, dtype=int, device=device)

    def begin(self) -> None:
        """A render begins: what is counted is counted anew."""
        self._pool.begin()
        self._looked = self._waited = 0

    def forget(self) -> None:
        """All rays are given up."""
        self._waits.phase.zero_()
        self._waits.counts.zero_()
        self._waits.leader.fill_(NOBODY)
        self._waiting, self._shadows_back = 0, False

    # --- a turn

    def take_shadows(self, back: RayList) -> None:
        """The shadow rays `back` have come back."""
        self._shadows_back = True
        self._launch(shadows_back_kernel, back.bound, self._waits.phase, back.slots, back.count)

    def ready_shadows(self, paths: Paths, rays: Rays, bound: int) -> RayList:
        """Shadow rays whose tiles are there, of at most `bound` that came back or waited; they are the caller's now."""
        if not (self._shadows_back or self._waiting):
            return NO_RAYS
        self._shadows_back = False
        listed = self._listed(bound, ready=0)
        threads = stage_thread_count(bound, self._device)
        self._launch(self._shadows, threads, self.data, self._waits, paths, rays, listed.slots, listed.count)
        return self._listed(bound, ready=1)

    def ready_paths(
        self, lists: PathLists, met: RayList, work: TileWork, limits: PathLimits, paths: Paths, rays: Rays
    ) -> tuple[RayList, RayList]:
        """Paths that may be shaded, of those whose rays are back or that waited: those that left the scene, and those
        that met a surface. `met` are those of the latter that did not wait, listed by `lists`.
        """
        if self._waiting:
            self._launch(look_again_kernel, self._path_count, self._waits.phase, paths.status)
            _, met = lists.back(paths.status, met.bound)
        threads = stage_thread_count(met.bound, self._device)
        seen = self.data, self._waits, work, limits, paths, rays
        self._launch(self._surfaces, threads, *seen, met.slots, met.count)
        wp.copy(self._counted, self._waits.counts)  # of the turn: it is read when the device has come to its end
        return lists.back(paths.status, met.bound)

    def bring(self) -> None:
        """At the end of a turn, when the device has done what was launched: bring tiles for rays that wait."""
        counts = to_numpy(self._counted)
        self._looked += int(counts[LOOKED])
        self._waited += int(counts[WAITED])
        self._waiting = int(counts[WAITING_NOW])
        if counts.any():
            self._waits.counts.zero_()
        if self._waiting:
            with self._timer.stage("copy"):
                self._pool.bring()
            leader = self._waits.leader
            wp.copy(leader, leader, dest_offset=LEADER, src_offset=NEXT_LEADER, count=1)
            leader[NEXT_LEADER : NEXT_LEADER + 1].fill_(NOBODY)

    # --- the report

    def totals(self) -> TileTotals:
        """What was done since the render began."""
        totals = self._pool.count()
        totals.looked, totals.waited = self._looked, self._waited
        return totals

    # --- lists

    def _listed(self, bound: int, ready: int) -> RayList:
        """Shadow rays that may go on, with `ready`, or are to be looked at."""
        count = self._path_count
        self._launch(choose_shadows_kernel, count, self._waits.phase, count, ready, self._chosen)
        wp.utils.array_scan(self._chosen, self._before, inclusive=False)
        self._launch(list_shadows_kernel, count, self._chosen, self._before, count, self._slots, self._count)
        return RayList(self._slots, self._count, bound)

    def _launch(self, kernel: wp.Kernel | None, count: int, *inputs) -> None:
        assert kernel is not None
        self._launches.launch(kernel, count, *inputs)
