"""The path tracer's loop over one tile. Each step is a stage; rays of many bounces are under way together."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import warp as wp

from ..film import layout_of
from ..film.tile import FilmTile, FilmTiles, FinishedTile, take_spill
from ..report.counters import Counters, CounterTotals
from ..report.timing import NoTimer
from ..scene.description import Frame
from ..settings import RenderSettings
from ..shading.sampling import filter_table
from .device_scene import DeviceScene
from .kernels import StageKernels
from .queues import Counts, GatherRule, PairQueue, Scratch
from .ray_order import RayOrder
from .rays import RayKind, Status, allocate_paths, allocate_rays
from .scheduler import Rectangle, WaterMarks
from .stages.generate import TileWork
from .stages.limits import path_limits
from .stages.trace import counter_features, tracing_stages
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
_BOUNCE, _SHADOW, _MISS, _SURFACE, _DONE, _FREE, _CAMERA, _SPILL, _SPLIT, _SPLIT_2, _SPLIT_3, _COUNTS = range(12)


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
        self._shadow_kind = RayKind.TRANSPARENT_SHADOW if scene.transparent_shadows else RayKind.OCCLUSION
        self._lists = TileLists(count, device)
        self._film_tiles = FilmTiles(count, self._layout, frame.passes, device, self._lists.counts.at(_SPILL))
        self._free = self._bounced = self._shadow = NO_SLOTS
        counting = counter_features(settings, frame.passes, scene.traversal)
        self._counters = Counters(counting, self._rays.origin.size, settings.bounce_max, device) if counting else None
        self._counts_steps = bool(counting and counting.steps)
        self._timer = self._counters.timer if self._counters else NoTimer()
        self._order = None
        if scene.tree and settings.ray_sort != "OFF":
            self._order = RayOrder(settings.ray_sort, count, scene.box, self._lists.counts, _SPLIT, self._timer)
        self._tracer = self._new_tracer() if scene.tree else None
        self._cost: wp.array | None = None
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
            self._trace(camera)
            self._shade(work, film)
            done += self._finish_paths(film)
        tile = state.tile
        with self._timer.stage("transfer"):
            finished = FinishedTile(
                (tile.x, tile.y, tile.width, tile.height), film, self._layout, self._frame.passes, done, self._cost
            )  # fmt: skip
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
        if self._counters:
            self._cost = self._counters.begin_tile(tile.pixel_count)
        return work, self._film_tiles.begin(tile.pixel_count)

    def _generate(self, state: TileState, work: TileWork, items: int) -> SlotList:
        count = self._marks.to_generate(self._alive, items - state.items_begun)
        if count == 0:
            return NO_SLOTS
        work.item_first, work.item_count = state.items_begun, count
        lengths = self._lists.counts.at(_CAMERA)
        with self._timer.stage("generate"):
            self._launch(
                self._kernels.generate, count, work, self._limits, self._scene.camera, self._paths, self._rays, self._free.slots, lengths
            )
        state.items_begun += count
        self._alive += count
        self.rays.camera += count
        return SlotList(self._free.slots, lengths, count, coherent=True)

    def _trace(self, camera: SlotList) -> None:
        waves = [(RayKind.CLOSEST, camera), (RayKind.CLOSEST, self._bounced), (self._shadow_kind, self._shadow)]
        waves = [(kind, rays) for kind, rays in waves if rays.bound]
        if self._tracer is None:
            # nothing to hit: ray slots say so from the start
            for _, rays in waves:
                self._launch_over(self._kernels.settle, rays, self._paths, self._rays)
            return
        for kind, rays in waves:
            self._tracer.submit(kind, rays)
        self._tracer.advance()
        for kind, back in self._tracer.take_finished():
            if self._counters:
                self._counters.add(kind, back, self._paths.bounce, self._paths.pixel, self._cost)
            with self._timer.stage("shade"):
                self._take_back(kind, back)

    def _take_back(self, kind: RayKind, back: SlotList) -> None:
        if kind == RayKind.CLOSEST:
            self._launch_over(self._kernels.settle, back, self._paths, self._rays)
        elif kind == RayKind.OCCLUSION:
            self._launch_over(self._kernels.connect, back, self._paths, self._rays)
        else:
            self._launch_over(self._kernels.connect_transparent, back, self._scene.data, self._limits, self._paths, self._rays)

    def _shade(self, work: TileWork, film: FilmTile) -> None:
        data, limits, paths, rays = self._scene.data, self._limits, self._paths, self._rays
        with self._timer.stage("lists"):
            miss, surface = self._lists.back(paths.status, self._alive)
        with self._timer.stage("shade"):
            if self._kernels.light_hits:
                self._launch_over(self._kernels.light_hits, miss, data, limits, paths, rays)
            self._launch_over(self._kernels.background, miss, data, limits, paths, rays, film)
            if self._kernels.surface:
                if self._kernels.light_hits:
                    self._launch_over(self._kernels.light_hits, surface, data, limits, paths, rays)
                self._launch_over(self._kernels.surface, surface, data, work, limits, paths, rays, film)

    def _finish_paths(self, film: FilmTile) -> int:
        """Move paths that are over to the film, and list the rays of the next turn; how many were over."""
        with self._timer.stage("lists"):
            done, self._free = self._lists.over(self._paths.status, self._marks.path_count)
            bounced, shadow = self._lists.new_rays(self._paths.status, self._alive)
            if self._order:
                self._order.split(bounced, self._paths.bounce, self.rays.camera)
        with self._timer.stage("film"):
            # the list of the done is no longer than there are paths alive
            self._launch(self._kernels.accumulate, self._alive, self._paths, film, done.slots, done.count)
        counts = self._lists.counts.fetch()
        if counts[_SPILL]:
            take_spill(film, counts[_SPILL], self._device)
        self._alive -= counts[_DONE]
        self.items_done += counts[_DONE]
        self.rays.bounced += counts[_BOUNCE]
        self.rays.shadow += counts[_SHADOW]
        self._bounced = dataclasses.replace(bounced, bound=counts[_BOUNCE])
        self._shadow = dataclasses.replace(shadow, bound=counts[_SHADOW])
        if self._order:
            self._order.told(counts)
        return counts[_DONE]

    def _give_up(self, state: TileState) -> None:
        """Leave the rays that are under way; the tile can be shown but not resumed."""
        state.drained = False
        self._paths.status.zero_()
        self._alive = 0
        self._bounced = self._shadow = NO_SLOTS
        self._tracer = self._new_tracer() if self._tracer else None

    # --- tracing

    def _new_tracer(self) -> UnbatchedTracer:
        stages = tracing_stages(self._scene.traversal, self._scene.features.instancing, self._counts_steps)
        return UnbatchedTracer(self._scene.tree, self._rays, stages, self._trace_in_order)

    def _trace_in_order(self, kind: RayKind, listed: SlotList, launch: Callable) -> None:
        counts = self._counters.work[kind] if self._counts_steps else None

        def timed(rays: SlotList) -> None:
            with self._timer.stage("trace"):
                launch(rays, counts)

        if self._order:
            self._order.trace(kind, listed, self._rays, self.rays.camera, timed)
        else:
            timed(listed)

    @property
    def is_counting(self) -> bool:
        """Whether anything is counted."""
        return self._counters is not None

    def counted(self) -> CounterTotals | None:
        """What was counted so far; None where nothing is."""
        return self._counters.totals() if self._counters else None

    def order_report(self) -> dict[str, Any] | None:
        """What was decided about sorting; None where rays are never sorted."""
        return self._order.policy.report() if self._order else None

    # --- launching

    def _launch_over(self, kernel: wp.Kernel, slots: SlotList, *inputs) -> None:
        if slots.bound:
            self._launch(kernel, slots.bound, *inputs, slots.slots, slots.count)

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        wp.launch(kernel, count, list(inputs), device=self._device)
