"""The path tracer's loop over one tile. Each step is a stage; rays of many bounces are under way together."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from ..film import layout_of
from ..film.tile import FilmTile, FilmTiles, FinishedTile, take_spill
from ..scene.description import Frame
from ..settings import RenderSettings
from ..shading.sampling import filter_table
from .device_scene import DeviceScene
from .kernels import StageKernels
from .queues import Counts, GatherRule, PairQueue, Scratch
from .rays import RayKind, Status, allocate_paths, allocate_rays
from .scheduler import Rectangle, WaterMarks
from .stages.generate import TileWork
from .stages.limits import path_limits
from .stages.trace import tracing_stages
from .tracer import NO_SLOTS, SlotList, UnbatchedTracer

# A stopped tile whose rays are not at their end after this long gives them up [s]
DRAIN_SECONDS = 0.25

_PENDING = int(Status.RAY_NEW | Status.RAY_OUT | Status.SHADOW_NEW | Status.SHADOW_OUT)
_SHADE = int(Status.ALIVE | Status.ENDED | Status.HIT) | _PENDING


@dataclass
class TileState:
    """How far a tile has come; with it a stopped tile goes on later."""

    tile: Rectangle
    items_begun: int = 0  # paths generated so far, in the sample order
    drained: bool = True  # all of them are in the film


@dataclass
class RayTotals:
    """Rays traced so far."""

    camera: int = 0
    bounced: int = 0  # scattered, or gone on behind a transparent surface
    shadow: int = 0

    @property
    def total(self) -> int:
        """Of all kinds."""
        return self.camera + self.bounced + self.shadow


# Places of the lists' lengths among the worker's counts
_BOUNCE, _SHADOW, _MISS, _SURFACE, _DONE, _FREE, _CAMERA, _SPILL, _COUNTS = range(9)


class TileLists:
    """The lists of a turn of the loop."""

    def __init__(self, path_count: int, device: wp.Device):
        new_ray, out_ray = int(Status.RAY_NEW), int(Status.RAY_NEW | Status.RAY_OUT)
        new_shadow, out_shadow = int(Status.SHADOW_NEW), int(Status.SHADOW_NEW | Status.SHADOW_OUT)
        alive, hit, ended = int(Status.ALIVE), int(Status.HIT), int(Status.ALIVE | Status.ENDED)
        shade = ended | hit | out_ray | out_shadow
        self.counts = Counts(_COUNTS, device)
        self._scratch = Scratch(path_count, device)

        def pair(a: GatherRule, b: GatherRule, place: int, b_has_a: bool = False) -> PairQueue:
            return PairQueue(path_count, a, b, self.counts, place, b_has_a)

        shadow = GatherRule(new_shadow, new_shadow, change=out_shadow, slot_first=path_count)
        self._new = pair(GatherRule(new_ray, new_ray, change=out_ray), shadow, _BOUNCE)
        self._back = pair(GatherRule(shade, alive), GatherRule(shade, alive | hit), _MISS)
        self._over = pair(GatherRule(ended | out_ray | out_shadow, ended), GatherRule(alive, 0), _DONE, b_has_a=True)

    def new_rays(self, status: wp.array, bound: int) -> tuple[SlotList, SlotList]:
        """Scattered rays and shadow rays that wait to be traced; they count as under way from now on."""
        return self._new.gather(status, self._scratch, bound)

    def back(self, status: wp.array, bound: int) -> tuple[SlotList, SlotList]:
        """Paths whose rays are all back: those that left the scene, and those that met a surface."""
        return self._back.gather(status, self._scratch, bound)

    def over(self, status: wp.array, path_count: int) -> tuple[SlotList, SlotList]:
        """Paths at their end, and all slots that are free once these are in the film."""
        return self._over.gather(status, self._scratch, path_count)


class TileIntegrator:
    """One worker: its rays, queues and the loop that moves them."""

    def __init__(self, scene: DeviceScene, frame: Frame, settings: RenderSettings, marks: WaterMarks):
        features, device, count = scene.features, scene.device, marks.path_count
        self._scene, self._frame, self._settings, self._marks, self._device = scene, frame, settings, marks, device
        self._kernels = StageKernels.choose(features, settings)
        self._limits = path_limits(settings, frame.width)
        self._layout = layout_of(frame.passes, frame.transparent)
        self._paths = allocate_paths(count, features, device)
        self._rays = allocate_rays(count * (2 if scene.shadow_rays else 1), device)
        self._tracer = None
        if scene.tree:
            stages = tracing_stages(scene.traversal, features.instancing, settings.counters == "ON")
            self._tracer = UnbatchedTracer(scene.tree, self._rays, stages)
        self._shadow_kind = RayKind.TRANSPARENT_SHADOW if scene.transparent_shadows else RayKind.OCCLUSION
        self._lists = TileLists(count, device)
        self._film_tiles = FilmTiles(count, self._layout, frame.passes, device, self._lists.counts.at(_SPILL))
        self._free = NO_SLOTS
        self._filter = wp.array(filter_table(settings.pixel_filter, settings.filter_width), dtype=float, device=device)
        self._alive = 0
        self.path_count = count  # slots: paths alive at once at most
        self.rays = RayTotals()
        self.invalid_samples = 0
        self.items_done = 0  # paths that came to their end, for progress

    def render(self, state: TileState, sample_first: int, sample_count: int, stop: Callable[[], bool]) -> FinishedTile:
        """Render what is left of a tile; `state` is brought up to date.

        When `stop()` turns true no path is begun any more, and those under way are brought to their end.
        """
        work, film = self._begin_tile(state, sample_first, sample_count)
        items = state.tile.pixel_count * sample_count
        done, stopped_at = 0, None
        while True:
            if stopped_at is None and stop():
                stopped_at = time.perf_counter()
            camera = NO_SLOTS
            if stopped_at is None:
                camera = self._generate(state, work, items)
            elif self._alive and time.perf_counter() - stopped_at > DRAIN_SECONDS:
                self._give_up(state)
            if self._alive == 0:
                break
            bounced = self._submit_new_rays(camera)
            self._trace([camera, bounced])
            self._shade(work, film)
            done += self._finish_paths(film)
        tile = state.tile
        finished = FinishedTile((tile.x, tile.y, tile.width, tile.height), film, self._layout, self._frame.passes, done)
        self.invalid_samples += finished.invalid
        return finished

    # --- the steps, in the order of the loop

    def _begin_tile(self, state: TileState, sample_first: int, sample_count: int) -> tuple[TileWork, FilmTile]:
        tile = state.tile
        work = TileWork()
        work.x, work.y, work.width, work.height = tile.x, tile.y, tile.width, tile.height
        work.frame_width = self._frame.width
        work.sample_first, work.sample_count = sample_first, sample_count
        work.filter_table = self._filter
        # every slot is free
        self._free = self._lists.over(self._paths.status, self._marks.path_count)[1]
        return work, self._film_tiles.begin(tile.pixel_count)

    def _generate(self, state: TileState, work: TileWork, items: int) -> SlotList:
        count = self._marks.to_generate(self._alive, items - state.items_begun)
        if count == 0:
            return NO_SLOTS
        work.item_first, work.item_count = state.items_begun, count
        lengths = self._lists.counts.at(_CAMERA)
        self._launch(
            self._kernels.generate, count, work, self._limits, self._scene.camera, self._paths, self._rays, self._free.slots, lengths
        )
        state.items_begun += count
        self._alive += count
        self.rays.camera += count
        return SlotList(self._free.slots, lengths, count, coherent=True)

    def _submit_new_rays(self, camera: SlotList) -> SlotList:
        bounced, shadow = self._lists.new_rays(self._paths.status, self._alive)
        if self._tracer:
            for rays in (camera, bounced):
                if rays.bound:
                    self._tracer.submit(RayKind.CLOSEST, rays)
            if self._scene.shadow_rays:
                self._tracer.submit(self._shadow_kind, shadow)
        return bounced

    def _trace(self, new_rays: list[SlotList]) -> None:
        if self._tracer is None:
            # nothing to hit: ray slots say so from the start
            for rays in new_rays:
                self._launch_over(self._kernels.settle, rays, self._paths, self._rays)
            return
        self._tracer.advance()
        for kind, back in self._tracer.take_finished():
            if kind == RayKind.CLOSEST:
                self._launch_over(self._kernels.settle, back, self._paths, self._rays)
            elif kind == RayKind.OCCLUSION:
                self._launch_over(self._kernels.connect, back, self._paths, self._rays)
            else:
                self._launch_over(
                    self._kernels.connect_transparent, back, self._scene.data, self._limits, self._paths, self._rays
                )

    def _shade(self, work: TileWork, film: FilmTile) -> None:
        data, limits, paths, rays = self._scene.data, self._limits, self._paths, self._rays
        miss, surface = self._lists.back(paths.status, self._alive)
        if self._kernels.light_hits:
            self._launch_over(self._kernels.light_hits, miss, data, limits, paths, rays)
        self._launch_over(self._kernels.background, miss, data, limits, paths, rays, film)
        if self._kernels.surface:
            if self._kernels.light_hits:
                self._launch_over(self._kernels.light_hits, surface, data, limits, paths, rays)
            self._launch_over(self._kernels.surface, surface, data, work, limits, paths, rays, film)

    def _finish_paths(self, film: FilmTile) -> int:
        """Move paths that are over to the film; how many."""
        done, self._free = self._lists.over(self._paths.status, self._marks.path_count)
        # the list of the done is no longer than there are paths alive
        self._launch(self._kernels.accumulate, self._alive, self._paths, film, done.slots, done.count)
        counts = self._lists.counts.fetch()
        if counts[_SPILL]:
            take_spill(film, counts[_SPILL], self._device)
        self._alive -= counts[_DONE]
        self.items_done += counts[_DONE]
        self.rays.bounced += counts[_BOUNCE]
        self.rays.shadow += counts[_SHADOW]
        return counts[_DONE]

    def _give_up(self, state: TileState) -> None:
        """Leave the rays that are under way; the tile can be shown but not resumed."""
        state.drained = False
        self._paths.status.zero_()
        self._alive = 0

    # --- launching

    def _launch_over(self, kernel: wp.Kernel, slots: SlotList, *inputs) -> None:
        if slots.bound:
            self._launch(kernel, slots.bound, *inputs, slots.slots, slots.count)

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        wp.launch(kernel, count, list(inputs), device=self._device)
