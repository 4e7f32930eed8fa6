"""The path tracer's loop over one tile. Each step is a stage; rays of many bounces are under way together."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from ..film import FIRST_SAMPLE_PASSES, ExactSums, Film, layout_of, no_wide
from ..scene.description import Frame
from ..settings import RenderSettings
from ..shading.sampling import filter_table
from .device_scene import DeviceScene
from .kernels import StageKernels
from .queues import GatherRule, Scratch, SlotQueue
from .rays import RayKind, Status, allocate_paths, allocate_rays
from .scheduler import Rectangle, WaterMarks
from .stages.accumulate import FilmTile, allocate_film_tile, take_spill
from .stages.generate import TileWork
from .stages.limits import path_limits
from .tracer import ReferenceTracer, SlotList

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
    extending: int = 0  # camera rays and those that scattered
    shadow: int = 0

    @property
    def total(self) -> int:
        """Of all kinds."""
        return self.extending + self.shadow


def gather_rules(path_count: int) -> dict[str, GatherRule]:
    """The lists of a turn of the loop, by name."""
    new_ray, out_ray = int(Status.RAY_NEW), int(Status.RAY_NEW | Status.RAY_OUT)
    new_shadow, out_shadow = int(Status.SHADOW_NEW), int(Status.SHADOW_NEW | Status.SHADOW_OUT)
    ended = int(Status.ALIVE | Status.ENDED)
    shade = ended | int(Status.HIT) | out_ray | out_shadow
    return {
        "free": GatherRule(int(Status.ALIVE), 0),
        "rays": GatherRule(new_ray, new_ray, change=out_ray),
        "shadow": GatherRule(new_shadow, new_shadow, change=out_shadow, slot_first=path_count),
        "miss": GatherRule(shade, int(Status.ALIVE)),
        "surface": GatherRule(shade, int(Status.ALIVE | Status.HIT)),
        "done": GatherRule(ended | out_ray | out_shadow, ended),
    }


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
        self._tracer = ReferenceTracer(scene.tree, self._rays, self._kernels.tracing(), device) if scene.tree else None
        self._shadow_kind = RayKind.TRANSPARENT_SHADOW if scene.transparent_shadows else RayKind.OCCLUSION
        self._rules = gather_rules(count)
        unused = set() if scene.shadow_rays else {"shadow"}
        unused |= set() if features.surfaces else {"surface"}
        self._queues = {name: SlotQueue(count, device) for name in self._rules if name not in unused}
        self._scratch = Scratch(count, device)
        self._filter = wp.array(filter_table(settings.pixel_filter, settings.filter_width), dtype=float, device=device)
        self._alive = 0
        self.path_count = count  # slots: paths alive at once at most
        self.rays = RayTotals()
        self.invalid_samples = 0
        self.items_done = 0  # paths that came to their end, for progress

    def render(self, state: TileState, sample_first: int, sample_count: int, stop: Callable[[], bool]) -> Film:
        """Render what is left of a tile and return the film of it; `state` is brought up to date.

        When `stop()` turns true no path is begun any more, and those under way are brought to their end.
        """
        work, film = self._begin_tile(state, sample_first, sample_count)
        items = state.tile.pixel_count * sample_count
        stopped_at = None
        while True:
            if stopped_at is None and stop():
                stopped_at = time.perf_counter()
            if stopped_at is None:
                self._generate(state, work, items)
            elif self._alive and time.perf_counter() - stopped_at > DRAIN_SECONDS:
                self._give_up(state)
            if self._alive == 0:
                return self._film_of(state.tile, film)
            new_rays = self._submit_new_rays()
            self._trace(new_rays)
            self._shade(work, film)
            self._finish_paths(film)

    # --- the steps, in the order of the loop

    def _begin_tile(self, state: TileState, sample_first: int, sample_count: int) -> tuple[TileWork, FilmTile]:
        tile = state.tile
        work = TileWork()
        work.x, work.y, work.width, work.height = tile.x, tile.y, tile.width, tile.height
        work.frame_width = self._frame.width
        work.sample_first, work.sample_count = sample_first, sample_count
        work.filter_table = self._filter
        film = allocate_film_tile(tile.pixel_count, self._marks.path_count, self._layout, self._frame.passes, self._device)
        return work, film

    def _generate(self, state: TileState, work: TileWork, items: int) -> None:
        count = self._marks.to_generate(self._alive, items - state.items_begun)
        if count == 0:
            return
        free = self._gather("free", self._marks.path_count)
        work.item_first = state.items_begun
        self._launch(self._kernels.generate, count, work, self._limits, self._scene.camera, self._paths, self._rays, free.slots)
        state.items_begun += count
        self._alive += count
        self.rays.camera += count

    def _submit_new_rays(self) -> SlotList:
        new_rays = self._gather("rays", self._alive)
        if self._tracer:
            self._tracer.submit(RayKind.CLOSEST, new_rays)
            if self._scene.shadow_rays:
                self._tracer.submit(self._shadow_kind, self._gather("shadow", self._alive))
        return new_rays

    def _trace(self, new_rays: SlotList) -> None:
        if self._tracer is None:
            # nothing to hit: ray slots say so from the start
            self._launch_over(self._kernels.settle, new_rays, self._paths, self._rays)
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
        miss = self._gather("miss", self._alive)
        if self._kernels.light_hits:
            self._launch_over(self._kernels.light_hits, miss, data, limits, paths, rays)
        self._launch_over(self._kernels.background, miss, data, limits, paths, rays, film)
        if self._kernels.surface:
            surface = self._gather("surface", self._alive)
            if self._kernels.light_hits:
                self._launch_over(self._kernels.light_hits, surface, data, limits, paths, rays)
            self._launch_over(self._kernels.surface, surface, data, work, limits, paths, rays, film)

    def _finish_paths(self, film: FilmTile) -> None:
        done = self._gather("done", self._alive)
        self._launch_over(self._kernels.accumulate, done, self._paths, film)
        spilled = int(film.spill_count.numpy()[0])
        if spilled:
            take_spill(film, spilled, self._device)
        finished = self._queues["done"].length()
        self._alive -= finished
        self.items_done += finished
        self.rays.extending += self._queues["rays"].length()
        if self._scene.shadow_rays:
            self.rays.shadow += self._queues["shadow"].length()

    def _give_up(self, state: TileState) -> None:
        """Leave the rays that are under way; the tile can be shown but not resumed."""
        state.drained = False
        self._paths.status.zero_()
        self._alive = 0

    def _film_of(self, tile: Rectangle, film: FilmTile) -> Film:
        frame = self._frame
        self.invalid_samples += int(film.invalid.numpy()[0])
        channels = self._layout.count
        wide = film.wide.numpy() if film.wide.shape[0] else no_wide()
        first = {"Depth": film.depth, "Position": film.position}
        return Film(
            frame.width, frame.height, (tile.x, tile.y, tile.x + tile.width, tile.y + tile.height),
            tuple(frame.passes), self._layout,
            ExactSums(film.window.numpy(), wide, channels), film.counts.numpy(),
            {name: first[name].numpy().reshape(-1) for name in frame.passes if name in FIRST_SAMPLE_PASSES},
        )  # fmt: skip

    # --- launching

    def _gather(self, name: str, bound: int) -> SlotList:
        return self._queues[name].gather(self._paths.status, self._scratch, self._rules[name], bound)

    def _launch_over(self, kernel: wp.Kernel, slots: SlotList, *inputs) -> None:
        self._launch(kernel, slots.bound, *inputs, slots.slots, slots.count)

    def _launch(self, kernel: wp.Kernel, count: int, *inputs) -> None:
        wp.launch(kernel, count, list(inputs), device=self._device)
