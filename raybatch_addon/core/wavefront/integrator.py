"""The path tracer's loop over one tile. Each step is a stage; rays of many bounces are under way together."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import warp as wp

from ..device.launches import NoTurns, RepeatedLaunches
from ..film import layout_of
from ..film.mattes import Mattes
from ..film.tile import FIRST_SAMPLE_ARRAYS, FilmTile, FilmTiles, FinishedTile
from ..measure.batching import BatchingTotals
from ..measure.counters import Counters, CounterTotals
from ..measure.timing import NoTimer
from ..rays import NO_RAYS, RayKind, RayList
from ..scene.description import Frame
from ..settings.settings import RenderSettings
from ..shading.sampling import filter_table
from .kernels import StageKernels
from .order.hit_order import HitOrder
from .order.ray_order import RayOrder
from .path_arrays import PathArrays
from .path_lists import Length, PathLists
from .scene.device_scene import DeviceScene
from .scheduler import WaterMarks
from .stages import generate
from .stages.generate import counted_kernel
from .stages.limits import path_limits
from .stages.stage import stage_thread_count
from .stages.work import ShadingStage, TileWork, VolumeStage
from .textures.fetching import TileFetcher
from .tile_state import RayTotals, TileState
from .tracers.choose import make_tracer
from .tracers.interface import Tracer
from .volumes.volumes import begin_counts, state_of

TAIL_SHARE = 0.125  # of the slots: below it, without paths to come, turns do little


class TileIntegrator:
    """One worker: its rays, queues and the loop that moves them."""

    traces_lists = True  # its tracer gets lists of rays

    def __init__(
        self,
        scene: DeviceScene,
        frame: Frame,
        settings: RenderSettings,
        marks: WaterMarks,
        tile_slots: int = 0,
        turns: NoTurns | None = None,
    ):
        """`tile_slots`: for tiles of images, where these are not whole; `turns`: shared by workers of the device."""
        self._turns = turns or NoTurns()
        features, device, count = scene.features, scene.device, marks.path_count
        self._scene, self._frame, self._marks, self.device = scene, frame, marks, device
        self._layout = layout_of(frame.passes, frame.transparent)
        self._arrays = arrays = PathArrays.allocate(scene, self._layout, settings, count)
        self._paths, self._rays = arrays.paths, arrays.rays
        self._catchers, self.volumes = arrays.catchers, arrays.volumes
        self._media = state_of(self.volumes)
        self._shadow_kind = RayKind.TRANSPARENT_SHADOW if scene.transparent_shadows else RayKind.OCCLUSION
        self._lists = PathLists(count, device, walks=features.subsurface)
        self._film_tiles = FilmTiles(self._layout, frame.passes, device, self._lists.counts.at(Length.SPILL))
        self._film_tiles.set_mattes_aside(self._lists.counts.at(Length.MATTES), count)
        self._free: wp.array | None = None
        self._bounced = self._shadow = NO_RAYS
        tracing = scene.tracing
        counting = tracing.counters(settings, frame.passes)
        self._counters = Counters(counting, self._rays.origin.size, settings.bounce_max, device) if counting else None
        self._counts_steps = bool(counting and counting.steps)
        # of each path, for the counters
        self._bounce, self._pixel = (wp.zeros(count if counting else 0, dtype=int, device=device) for _ in range(2))
        self._timer = self._counters.timer if self._counters else NoTimer()
        self._order = self._hit_order = None
        if scene.tree and (sort_mode := tracing.sort_mode(settings)) != "OFF":
            self._order = RayOrder(sort_mode, count, scene.box, device, self._timer)
        if key := scene.hits_sorted_by(settings):
            data = scene.data
            self._hit_order = HitOrder(count, key, data.geometry, data.materials.records, device, self._timer)
        # None: all images are whole
        self.textures = TileFetcher(scene, count, tile_slots, self._timer) if tile_slots else None
        self._data = self.textures.data if self.textures else scene.data
        self._tracer: Tracer | None = None  # there is nothing to hit
        if scene.tree and self.traces_lists:
            counts, order = self._counters if self._counts_steps else None, self._order
            self._tracer = make_tracer(
                scene, self._rays, count, self._shadow_kind, settings, counters=counts, timer=self._timer, order=order
            )
        self._cost: wp.array | None = None
        self._mattes = Mattes()  # of the tile, beside those in its slots
        self._filter = wp.array(filter_table(settings.pixel_filter, settings.filter_width), dtype=float, device=device)
        self._launch = RepeatedLaunches(device).launch
        self.path_count = count  # slots: paths alive at once at most
        self.seconds_a_path = math.inf  # of the last tile; inf: there was none
        self.begin(settings)

    def begin(self, settings: RenderSettings) -> None:
        """A render begins, by `settings` that differ from those before in their random numbers alone."""
        self._settings, scene = settings, self._scene
        self._kernels = StageKernels.choose(scene.features, self.device, scene.shading)
        self._wanted_kernels = self._kernels  # for the next turn
        self._half_limits = [path_limits(settings, self._frame, half) for half in range(settings.half_count)]
        self._limits = self._half_limits[0]
        if self._order:
            self._order.begin()
        self.rays, self._alive = RayTotals(), 0
        self._film_tiles.begin_render()
        begin_counts(self.volumes)
        if self.textures:
            self.textures.begin()
        self.items_done = 0  # paths that came to their end, for progress
        self.seconds_working = 0.0  # on tiles, in this render
        self.tail_seconds = 0.0  # of the last `render`: behind its last full waves
        self.patience = math.inf  # of a stopped tile whose rays are under way [s]; 0: they are given up in mid-turn

    def render(
        self, state: TileState, sample_first: int, sample_count: int, stop: Callable[[], bool], most: float = math.inf
    ) -> FinishedTile:
        """Render what is left of a tile's samples `sample_first` to `sample_first + sample_count`, but begin no more
        than `most` paths; `state` is brought up to date.

        They are added to what the tile has from earlier rounds. When `stop()` turns true no path is begun any more, and
        those under way are brought to their end.
        """
        with self._turns:
            work, film = self._begin_tile(state, sample_first, sample_count)
            self._free = self._lists.all_free(self._paths.status)
        items = min(state.pixel_count * sample_count, state.items_begun + most)
        done, stopped_at, tail_from = 0, None, None
        while True:
            if stopped_at is None and stop():
                stopped_at = time.perf_counter()
            with self._turns:
                self._kernels = self._wanted_kernels
                camera = NO_RAYS
                if stopped_at is None:
                    camera = self._generate(state, work, items)
                elif self._alive and time.perf_counter() - stopped_at >= self.patience:
                    self._give_up(state)
                if tail_from is None and state.items_begun == items and self._alive <= TAIL_SHARE * self.path_count:
                    tail_from = time.perf_counter()
                if self._alive == 0:
                    break
                back = self._trace(work, film, camera, stop)
                if self.patience > 0.0 or not stop():  # else paths are given up, whatever came back
                    self._shade(work, film, min(back, self._alive))
                    done += self._finish_paths(work, film, stopped_at is None and state.items_begun < items)
        with self._turns:
            return self._end_tile(state, film, done, tail_from)

    def _end_tile(self, state: TileState, film: FilmTile, done: int, tail_from: float | None) -> FinishedTile:
        tile = state.tile
        if state.half:
            # the first sample of the other half decides
            for name in FIRST_SAMPLE_ARRAYS.values():
                getattr(film, name).zero_()
        count = done + (state.held.sample_count if state.held else 0)
        state.held = FinishedTile(tile.box, film, self._layout, self._frame.passes, count, self._cost, self._mattes)
        self.tail_seconds = time.perf_counter() - tail_from if tail_from else 0.0
        return state.held

    def shown(self, halves: Sequence[FinishedTile]) -> FinishedTile:
        """A tile that this worker rendered, with its pictures; called in nobody's turn."""
        with self._timer.stage("transfer"):
            return FinishedTile.of_halves(halves)

    def use_kernels(self, kernels: StageKernels) -> None:
        """Go on with `kernels` of another tier, loaded already, from the next turn on. May be called on any thread."""
        self._wanted_kernels = kernels

    def release(self) -> None:
        """Give up what was captured for the device, after the last tile; called on the thread that made this."""
        if self._tracer:
            self._tracer.release()

    @property
    def invalid_samples(self) -> int:
        """Samples of this render that were not finite and count as black; waits for the device."""
        return self._film_tiles.invalid_samples

    # --- the steps, in the order of the loop

    def _begin_tile(self, state: TileState, sample_first: int, sample_count: int) -> tuple[TileWork, FilmTile]:
        tile = state.tile
        work = TileWork()
        work.x, work.y, work.width, work.height = tile.x, tile.y, tile.width, tile.height
        work.frame_width, work.filter_table = self._frame.width, self._filter
        work.sample_first, work.sample_count = sample_first, sample_count
        work.pixel_first = int(self._settings.sample_order == "PIXEL_FIRST")
        # numbers of paths are of all pixels, and those of pixels that go on begin at no item of theirs
        work.item_base = state.items_begun if state.active is None else 0
        self._limits = self._half_limits[state.half]
        held = state.held
        self._mattes = held.mattes if held else Mattes()
        if self._counters:
            self._cost = held.cost if held and held.cost is not None else self._counters.begin_tile(tile.pixel_count)
        return work, self._film_tiles.begin(tile.pixel_count, held.go_on() if held else None)

    def _generate(self, state: TileState, work: TileWork, items: int) -> RayList:
        kernel, more, left = self._kernels.generate_active, (state.active,), items - state.items_begun
        if state.active is None:
            kernel, more = self._kernels.generate, ()
            if self._alive == 0:
                work.item_base = state.items_begun
            # paths are numbered by 32 bits: beyond them, numbers begin anew when no path is alive
            left = min(items, work.item_base + generate.ITEMS_NUMBERED) - state.items_begun
        count = self._marks.to_generate(self._alive, left)
        if count == 0:
            return NO_RAYS
        work.item_first, work.item_count = state.items_begun, count
        length = self._lists.counts.at(Length.CAMERA)
        with self._timer.stage("generate"):
            into = self._paths, self._rays, self._free, length
            self._launch(kernel, count, work, self._limits, self._scene.camera, *into, *more)
            if self.volumes:
                enter, seen = self._kernels.volumes.enter, (self._scene.data.geometry, self.volumes)
                self._launch(enter, count, *seen, self._rays, self._free, length)
        state.items_begun += count
        self._alive += count
        self.rays.camera += count
        if self._order:
            self._order.note_begun(self.rays.camera)
        return RayList(self._free, length, count, coherent=True)

    def _trace(self, work: TileWork, film: FilmTile, camera: RayList, stop: Callable[[], bool]) -> int:
        """Rays go on; how many came back at most."""
        waves = [(RayKind.CLOSEST, camera), (RayKind.CLOSEST, self._bounced), (self._shadow_kind, self._shadow)]
        waves = [(kind, rays) for kind, rays in waves if rays.bound]
        self._bounced = self._shadow = NO_RAYS
        if self._tracer is None:
            # nothing to hit: ray slots say so from the start
            for kind, rays in waves:
                self._take_back(kind, rays, work, film)
            return sum(rays.bound for _, rays in waves)
        for kind, rays in waves:
            # rays that wait are sorted before; a tracer takes them in at once
            is_sorted = self._order and self._scene.tracing.waits
            for part in self._order.parts(kind, rays, self._rays) if is_sorted else (rays,):
                self._tracer.submit(kind, part)
        self._tracer.advance(stop)
        finished = self._tracer.take_finished()
        for kind, back in finished:
            if self._counters:
                self._launch(counted_kernel, self.path_count, work, self._paths, self._bounce, self._pixel)
                self._counters.add(kind, back, self._bounce, self._pixel, self._cost)
            with self._timer.stage("shade"):
                self._take_back(kind, back, work, film)
        return sum(back.bound for _, back in finished)

    def _take_back(self, kind: RayKind, back: RayList, work: TileWork, film: FilmTile) -> None:
        if kind == RayKind.CLOSEST:
            self._launch_over(self._kernels.settle, back, self._paths, self._rays)
        elif self.textures and self.textures.holds_shadows:
            self.textures.take_shadows(back)
        else:
            self._connect(kind, back, work, film)

    def _connect(self, kind: RayKind, back: RayList, work: TileWork, film: FilmTile) -> None:
        if kind == RayKind.OCCLUSION:
            self._launch_stage(ShadingStage.CONNECT, back, work, film)
        else:
            if self.volumes:
                self._launch_volumes(VolumeStage.TRANSMIT, back, work)
            self._launch_stage(ShadingStage.CONNECT_TRANSPARENT, back, work, film)

    def _shade(self, work: TileWork, film: FilmTile, bound: int) -> None:
        """Paths whose rays are all back go on: at most `bound`."""
        data, limits, paths, rays = self._data, self._limits, self._paths, self._rays
        if self.textures:
            bound = self._alive  # also those that wait for tiles
            if self.textures.holds_shadows:
                with self._timer.stage("shade"):
                    self._connect(self._shadow_kind, self.textures.ready_shadows(paths, rays, bound), work, film)
        with self._timer.stage("lists"):
            miss, surface = self._lists.back(paths.status, bound)
        with self._timer.stage("shade"):
            if self._arrays.requests:
                for stage, back in itertools.product((ShadingStage.REQUEST, ShadingStage.OCCLUSION), (miss, surface)):
                    self._launch_stage(stage, back, work, film)
                miss, surface = self._lists.back(paths.status, bound)  # without those that wait for answers
            if self._kernels.walk:
                for back in (miss, surface):
                    self._launch_over(self._kernels.walk, back, data, work, limits, paths, rays)
            if self.volumes:
                for back in (miss, surface):
                    self._launch_volumes(VolumeStage.SCATTER, back, work)
                miss, surface = self._lists.back(paths.status, bound)  # without those that scattered
            if self.textures:
                miss, surface = self.textures.ready_paths(self._lists, surface, work, limits, paths, rays)
            self._launch_stage(ShadingStage.LIGHT_HITS, miss, work, film)
            self._catch(miss)
            self._launch_stage(ShadingStage.BACKGROUND, miss, work, film)
        if not self._scene.features.surfaces:
            return
        for hits in self._hit_order.parts(rays, surface) if self._hit_order else (surface,):
            with self._timer.stage("shade"):
                self._launch_stage(ShadingStage.LIGHT_HITS, hits, work, film)
                self._catch(hits)
                self._launch_stage(ShadingStage.AIM, hits, work, film)
                self._launch_stage(ShadingStage.SURFACE, hits, work, film)
                if self.volumes:
                    crossed = data, self.volumes, paths, rays
                    self._launch_over(self._kernels.volumes.cross, hits, *crossed)

    def _finish_paths(self, work: TileWork, film: FilmTile, generates: bool) -> int:
        """Move paths that are over to the film, and list the rays of the next turn; how many were over.

        `generates`: there are paths to generate, which need free slots.
        """
        if self._catchers:
            state = self._paths, self._rays, self._media, self._catchers
            self._launch(self._kernels.catchers[1], self.path_count, *state)
        by_bounce = self._order is not None and self._order.wants_parts()
        with self._timer.stage("lists"):
            done = self._lists.end_turn(self._paths.status, self._alive, by_bounce, generates)
        with self._timer.stage("film"):
            self._launch_over(self._kernels.accumulate, done, work, self._paths, film)
        self._lists.counts.send()
        with self._turns.left():
            lengths = self._lists.counts.arrived()
            if lengths[Length.MATTES]:
                self._mattes = self._mattes.plus(self._film_tiles.mattes_aside(lengths[Length.MATTES]))
        if self.textures:
            self.textures.bring()
        if self._film_tiles.take_spill(film, lengths[Length.SPILL]):
            self._launch_over(self._kernels.accumulate, done, work, self._paths, film)
        self._alive -= lengths[Length.DONE]
        self.items_done += lengths[Length.DONE]
        self.rays.bounced += lengths[Length.BOUNCE]
        self.rays.shadow += lengths[Length.SHADOW]
        turn = self._lists.next_turn(lengths, by_bounce, generates)
        self._free, self._bounced, self._shadow = turn.free, turn.bounced, turn.shadow
        if self._order:
            self._order.note_bounced(turn.bounced, turn.bounced_parts)
        return lengths[Length.DONE]

    def _give_up(self, state: TileState) -> None:
        """Leave the rays that are under way; the tile can be shown but not resumed."""
        state.drained = False
        self._arrays.free_all()
        if self.textures:
            self.textures.forget()
        self._alive = 0
        # rays of the next turn were not traced
        self.rays.bounced -= self._bounced.bound
        self.rays.shadow -= self._shadow.bound
        self._bounced = self._shadow = NO_RAYS
        if self._tracer:
            self._tracer.forget()

    # --- tracing

    def batching_totals(self) -> BatchingTotals | None:
        """What rays waited for so far; None where they do not wait."""
        return self._tracer.totals() if self._tracer and self._scene.tracing.waits else None

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

    def _launch_stage(self, stage: ShadingStage, slots: RayList, work: TileWork, film: FilmTile) -> None:
        kernel = self._kernels.shading.get(stage)
        if kernel is not None:
            work.stage = int(stage)
            inputs = self._data, work, self._limits, self._paths, self._rays, film, slots.slots, slots.count
            self._launch(kernel, stage_thread_count(slots.bound, self.device), *inputs)

    def _launch_volumes(self, stage: VolumeStage, slots: RayList, work: TileWork) -> None:
        volumes = self._kernels.volumes
        kernel = volumes.scatter if stage is VolumeStage.SCATTER else volumes.transmit
        work.stage = int(stage)
        inputs = self._data, self.volumes, work, self._limits, self._paths, self._rays
        self._launch_over(kernel, slots, *inputs)

    def _catch(self, slots: RayList) -> None:
        if self._catchers:
            self._launch_over(self._kernels.catchers[0], slots, self._paths, self._rays, self._catchers)

    def _launch_over(self, kernel: wp.Kernel, slots: RayList, *inputs) -> None:
        if slots.bound:
            self._launch(kernel, slots.bound, *inputs, slots.slots, slots.count)
