"""A worker of the streaming schedule: it launches the persistent kernel, looks at what came of it, and goes on.

Between launches no path is in the hands of a warp: each is in a queue, and goes on in the next launch. So a launch can
end after so much work, and a render be stopped, kept and shown as with the wavefront.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import warp as wp

from ...bvh.traverse.counts import NO_COUNTS
from ...device.devices import load_module
from ...film.tile import FilmTile, FinishedTile
from ...native.structs import to_numpy
from ...scene.description import Frame
from ...scene.passes import matte_kinds
from ...settings.settings import RenderSettings
from ..integrator import TAIL_SHARE, TileIntegrator
from ..path_lists import Length
from ..plan.launch import Launch
from ..rays import allocate_progress, trail_words
from ..scene.device_scene import DeviceScene
from ..scheduler import WaterMarks
from ..stages import generate
from ..stages.work import TileWork
from ..tile_state import TileState
from ..volumes.table import VolumeData
from .checks import check_queues
from .kernel import BLOCK_SIZE, Stream, kernel_for
from .queues import AT_RANDOM, IN_TURN, Counter, Queue, allocate_queues, fill_queues, warp_size
from .trace import TracedTree

# A launch is to take about this long, so that a render stops soon and shows how far it is [s]
LAUNCH_SECONDS = 0.1
# How far the tokens of a launch may differ from those of the last; how many there are at least and at most
_GROWTH = 4.0
_WORK_LEAST, _WORK_MOST = 1 << 12, 1 << 29
# Tokens that a warp takes at a time: on a CPU enough that a traversal carries many rays all the time
_CUDA_BATCH, _CPU_BATCH = 512, 1024
# Warps of each multiprocessor, about as many as its registers are enough for
_WARPS_A_PROCESSOR = 16


class StreamingIntegrator(TileIntegrator):
    """As `TileIntegrator`, whose loop it puts onto the device."""

    traces_lists = False

    def __init__(
        self, scene: DeviceScene, frame: Frame, settings: RenderSettings, marks: WaterMarks, tile_slots: int = 0
    ):
        """`tile_slots` is 0: all images are whole (`plan/schedule.py`)."""
        super().__init__(scene, frame, settings, marks, tile_slots)
        device, count, batches = self.device, self.path_count, scene.treelets
        slot_count = self._rays.origin.size
        warps = self._warp_count(settings)
        # where paths are few: at most half of what a warp would have if all had alike, so that as many wait in queues
        most = min(_CUDA_BATCH if device.is_cuda else _CPU_BATCH, count // (2 * warps))
        batch = min(max(most, warp_size(device)), count)
        treelets = batches.treelet_count if batches else 0
        self._queues = queues = allocate_queues(count, treelets, warps, batch, -(-batch // 2), device)
        queues.selection = {"NEXT": IN_TURN, "RANDOM": AT_RANDOM}.get(settings.bucket_selection, 0)
        self._stream = stream = Stream()
        stream.traced = TracedTree()
        stream.traced.counts = NO_COUNTS
        if batches:
            queues.shadow_queue = int(Queue.TRACE)
            stream.traced.tree, stream.traced.treelets = batches.tree, batches.treelets
            words = trail_words(batches.levels)
            stream.traced.progress = allocate_progress(slot_count, words, batches.instancing, device)
            stream.traced.location = wp.zeros(slot_count, dtype=int, device=device)
        elif scene.tree:
            stream.traced.tree = scene.tree
        stream.volumes = self.volumes or VolumeData()
        self._no_pixels = wp.empty(0, dtype=int, device=device)
        stream.one = wp.full(1, 1, dtype=int, device=device)
        stream.queues = queues
        self._warps = warps
        self._debug = settings.is_on("debug_checks")
        self._kernel = kernel_for(scene.features, scene.tracing, settings, device)
        load_module(self._kernel, device)
        self._work_most = _WORK_MOST
        if matte_kinds(frame.passes):
            # a token sets aside a weight of each kind at most, and a warp takes a batch beyond what a launch is to take
            self._work_most = max(count, _WORK_LEAST)
            aside = self._work_most + warps * queues.batch
            self._film_tiles.set_mattes_aside(self._lists.counts.at(Length.MATTES), aside)
        # tokens of a launch: at least a batch for each warp
        self._work_least = min(max(warps * queues.batch, _WORK_LEAST), self._work_most)
        self._work = self._work_least  # of the next one

    def _warp_count(self, settings: RenderSettings) -> int:
        if not self.device.is_cuda:
            return 1
        needed = -(-self.path_count // warp_size(self.device))
        asked = Launch.of(settings).warp_count or self.device.sm_count * _WARPS_A_PROCESSOR
        whole = BLOCK_SIZE // warp_size(self.device)
        return -(-min(needed, asked) // whole) * whole

    def render(
        self, state: TileState, sample_first: int, sample_count: int, stop: Callable[[], bool], most: float = math.inf
    ) -> FinishedTile:
        work, film = self._begin_tile(state, sample_first, sample_count)
        items = min(state.pixel_count * sample_count, state.items_begun + most)
        self._stream.active = self._no_pixels if state.active is None else state.active
        done, stopped_at, tail_from = 0, None, None
        while True:
            if stopped_at is None and stop():
                stopped_at = time.perf_counter()
            left = 0
            if stopped_at is None:
                left = self._items_to_begin(state, work, items)
            elif self._alive and time.perf_counter() - stopped_at >= self.patience:
                self._give_up(state)
            if tail_from is None and state.items_begun == items and self._alive <= TAIL_SHARE * self.path_count:
                tail_from = time.perf_counter()
            if self._alive == 0 and left == 0:
                break
            done += self._launch_stream(state, work, film, left)
        return self._end_tile(state, film, done, tail_from)

    def _items_to_begin(self, state: TileState, work: TileWork, items: int) -> int:
        """How many items the next launch may begin, the first of which `work` gets."""
        left = items - state.items_begun
        if state.active is None:
            if self._alive == 0:
                work.item_base = state.items_begun
            left = min(items, work.item_base + generate.ITEMS_NUMBERED) - state.items_begun
        work.item_first = state.items_begun
        return int(min(left, _WORK_MOST))

    def _launch_stream(self, state: TileState, work: TileWork, film: FilmTile, left: int) -> int:
        """Let warps work for a while, and begin at most `left` items; how many paths came to their end."""
        queues, start = self._queues, time.perf_counter()
        queues.limit, queues.budget = left, self._work
        queues.counters[Counter.BEGUN : Counter.BEGUN + 1].zero_()
        queues.counters[Counter.WORK :].zero_()
        self._stream.queues = queues
        with self._timer.stage("stream"):
            wp.launch(
                self._kernel,
                self._warps * warp_size(self.device),
                [self._data, work, self._limits, self._scene.camera, self._paths, self._rays, film, self._stream],
                device=self.device,
                block_dim=BLOCK_SIZE,
            )
        counted = dict(zip(Counter, to_numpy(queues.counters).tolist(), strict=True))
        lengths = self._lists.counts.fetch()
        if lengths[Length.MATTES]:
            self._mattes = self._mattes.plus(self._film_tiles.mattes_aside(lengths[Length.MATTES]))
        self._film_tiles.take_spill(film, lengths[Length.SPILL])
        begun = min(counted[Counter.BEGUN], left)
        self._alive = counted[Counter.ALIVE]
        if counted[Counter.FAULT] or (counted[Counter.WORK] == 0 and (self._alive or left)):
            raise RuntimeError(_fault(counted))
        if self._debug:
            check_queues(queues, self._paths.status, self._alive)
        state.items_begun += begun
        self.items_done += counted[Counter.ENDED]
        self.rays.camera += begun
        self.rays.bounced += counted[Counter.RAYS] - begun
        self.rays.shadow += counted[Counter.SHADOW_RAYS]
        self._plan_work(counted[Counter.WORK], time.perf_counter() - start)
        return counted[Counter.ENDED]

    def _plan_work(self, done: int, seconds: float) -> None:
        """How much the next launch takes, where the last took `done` tokens: one that ended early says little."""
        if done >= self._work or seconds > LAUNCH_SECONDS:
            wanted = min(LAUNCH_SECONDS / max(seconds, 1e-6) * done, _GROWTH * self._work)
            self._work = int(min(max(wanted, self._work_least), self._work_most))

    def _give_up(self, state: TileState) -> None:
        super()._give_up(state)
        fill_queues(self._queues, self.path_count)


def _fault(counted: dict[Counter, int]) -> str:
    what = ", ".join(f"{each.name.lower()} {number}" for each, number in counted.items())
    where = counted[Counter.FAULT] - 1
    named = Queue(where).name if where in set(Queue) else f"the treelet {where - len(Queue)}"
    about = f"an entry of the queue {named} was waited for in vain" if where >= 0 else "no warp found anything to do"
    return f"the streaming schedule does not go on: {about} ({what}); set schedule to WAVEFRONT"
