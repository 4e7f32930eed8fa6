"""The workers of a render: as many integrators as there are threads, or one or two of a CUDA device, each with as many
paths as memory allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import warp as wp

from ...device.devices import free_memory, worker_count
from ...device.failures import lacks_memory
from ...device.launches import LaunchTurns
from ...errors import OutOfMemoryError
from ...film import layout_of
from ...film.sums import WINDOW_DIGITS
from ...measure.counters import counter_bytes_per_path
from ...scene.description import Frame
from ...settings.settings import RenderSettings
from ..integrator import TileIntegrator
from ..order.hit_order import hit_order_bytes
from ..order.ray_order import order_bytes
from ..plan.plan import Choice, Method
from ..rays import bytes_per_path
from ..scene.device_scene import DeviceScene
from ..scene.kept_scene import KeptScene, settings_but_seeds
from ..scheduler import (
    CUDA_RAYS,
    CUDA_RAYS_MOST,
    CUDA_WORKERS,
    ROOM_SHARE,
    paths_a_worker,
    reduced_path_count,
    serves_many,
    water_marks,
)
from ..textures.pool import tile_slots_of
from ..tier import array_features
from ..tracers.buckets.tracer import selection_of
from ..tracers.choose import tracer_bytes_per_path

# Share of the free memory that paths may take
PATH_MEMORY_SHARE = 0.6
# Size of samples that are set aside on their way to the film [bytes]
SPILL_BYTES = 1 << 19
# Memory of each pixel at a look at its noise: colors of both halves, noise and its sums, and lists of pixels [bytes]
LOOK_BYTES = 64
# Most memory of workers that wait for the next render of their scene [bytes]
_KEPT_MOST = 1 << 25


@dataclass
class Workers:
    """The integrators of a render, and what was found when they were made."""

    integrators: list[TileIntegrator] = field(default_factory=list)
    path_bytes: int = 0  # device memory of a path alive: all that grows with their number
    worker_bytes: int = 0  # of all that a worker has
    warnings: list[str] = field(default_factory=list)
    chosen: dict[str, Choice] = field(default_factory=dict)  # for settings that were left open


class WorkersFor:
    """Workers for tiles of so many pixels and samples of a scene: those of its last render, or others."""

    def __init__(self, kept: KeptScene, scene: DeviceScene, frame: Frame, settings: RenderSettings) -> None:
        self._kept, self._scene, self._frame, self._settings = kept, scene, frame, settings
        self._key: tuple = ()
        self._made = Workers()

    def get(self, areas: Sequence[int], sample_count: int) -> Workers:
        """As `make_workers`."""
        self._key = settings_but_seeds(self._settings), tuple(areas), sample_count
        found = self._kept.take_workers(self._scene, self._key)
        if found is None:
            found = make_workers(self._scene, self._frame, self._settings, areas, sample_count)
        else:
            for each in found.integrators:
                each.begin(self._settings)
        self._made = found
        return found

    @property
    def integrators(self) -> list[TileIntegrator]:
        """The workers that `get` returned."""
        return self._made.integrators

    def keep(self) -> None:
        """All that was asked of the workers is done: they serve the next render of the scene too, unless they take much
        memory, or count from render to render. That of a CUDA device is planned by what is free.
        """
        made, scene = self._made, self._scene
        is_small = made.worker_bytes * len(made.integrators) <= _KEPT_MOST
        counts = scene.tracing.waits or any(each.is_counting for each in made.integrators)
        if is_small and not counts and not scene.device.is_cuda:
            self._kept.keep_workers(scene, self._key, made)


@dataclass(frozen=True)
class _Room:
    """How many workers there are, and how many paths each has."""

    workers: int
    asked: int  # paths of each, were there memory for them
    paths: int  # 0: not even one fits
    path_bytes: int
    other_bytes: int  # of what each has beside its paths
    budget: int  # for the paths of each [bytes]
    slots: int  # of tiles of images


def make_workers(
    scene: DeviceScene, frame: Frame, settings: RenderSettings, areas: Sequence[int], sample_count: int
) -> Workers:
    """Workers for tiles of so many pixels and samples; raises `OutOfMemoryError` where not even one path fits."""
    made = Workers()
    if not areas:
        return made
    device, many = scene.device, brings_in(scene)
    in_turns = launches_in_turns(scene, frame, settings)
    room = _room_in_turns(scene, frame, settings, areas, sample_count) if in_turns else None
    if room is None:
        workers = min(worker_count(device, settings.thread_count), settings.ray_count or len(areas), len(areas))
        room = _room(scene, frame, settings, areas, sample_count, workers)
    worker, turns = worker_class(settings), (LaunchTurns(),) if in_turns and room.workers > 1 else ()
    while not made.integrators:
        if room.paths == 0:
            raise OutOfMemoryError(
                f"{device.alias} has {room.budget * room.workers:,} bytes left for rays beside the film's tiles, and "
                f"one path takes {room.path_bytes}; close other programs, lower tile_size, or render a smaller scene"
            )
        try:
            its = scene, frame, settings, water_marks(settings, room.paths), room.slots
            made.integrators = [worker(*its, *turns) for _ in range(room.workers)]
        except (MemoryError, RuntimeError) as error:
            if room.paths == 1 or not lacks_memory(error):
                raise
        if not made.integrators:  # behind the error, which keeps alive what was allocated
            tried = room.paths
            if turns:
                if device.is_cuda:
                    wp.synchronize_device(device)  # what was allocated is given back
                room, turns = _room(scene, frame, settings, areas, sample_count, 1), ()
            room = replace(room, paths=min(room.paths, max(1, tried // 2)))
    workers, count = room.workers, room.paths
    made.path_bytes, made.worker_bytes = room.path_bytes, count * room.path_bytes + room.other_bytes
    if not settings.ray_count:
        made.chosen["ray_count"] = Choice(count * workers, _why_so_many(device.is_cuda, many, workers))
    if settings.bucket_selection == "AUTO" and scene.treelets and settings.schedule == "WAVEFRONT":
        made.chosen["bucket_selection"] = Choice(
            selection_of(settings).name, "every launch is large" if device.is_cuda else "rays wait less often"
        )
    if settings.spatial_splits == "AUTO" and scene.splits:
        made.chosen["spatial_splits"] = scene.splits
    if count < room.asked and not (many and not settings.ray_count):
        made.warnings.append(
            f"ray_count was reduced from {room.asked * workers:,} to {count * workers:,}: {device.alias} has not "
            "enough free memory"
        )
    elif fewer := fewer_alive(settings.ray_count, workers, areas, sample_count):
        made.warnings.append(fewer)
    return made


def _why_so_many(is_cuda: bool, many: bool, workers: int) -> str:
    if many:
        return "as many as memory and the samples of a tile allow: all that is brought in serves more of them"
    if not is_cuda:
        return "a wave stays within the outer caches"
    if workers > 1:
        most = f"up to {CUDA_RAYS_MOST:,} of each worker"
        return f"{most}, as far as a tile has them and an eighth of the free memory holds them"
    return "some times what keeps the device busy"


def in_image_tiles(scene: DeviceScene) -> bool:
    """Whether images come to the device tile by tile."""
    return scene.fetches is not None and scene.images.tiled is not None


def brings_in(scene: DeviceScene) -> bool:
    """Whether what is brought in is to serve many rays."""
    return serves_many(scene.tracing.method is Method.PAGED, in_image_tiles(scene), scene.device.is_cuda)


def launches_in_turns(scene: DeviceScene, frame: Frame, settings: RenderSettings) -> bool:
    """Whether two workers may share a CUDA device: no ray waits for others, nothing is timed or counted, and there are
    to be as many paths as keep two busy, or their number is left open.
    """
    if not scene.device.is_cuda or settings.schedule != "WAVEFRONT":
        return False
    if 0 < settings.ray_count < CUDA_WORKERS * CUDA_RAYS:
        return False
    waits = scene.tracing.waits or in_image_tiles(scene)
    return not waits and scene.tracing.counters(settings, frame.passes) is None


def _room_in_turns(
    scene: DeviceScene, frame: Frame, settings: RenderSettings, areas: Sequence[int], sample_count: int
) -> _Room | None:
    """For two workers of a CUDA device; None where it has one, which is faster with few paths: the picture has one
    tile, or two would not have what keeps a device busy within their share of the free memory.
    """
    if len(areas) < CUDA_WORKERS:
        return None
    room = _room(scene, frame, settings, areas, sample_count, CUDA_WORKERS)
    if settings.ray_count:
        return room if room.paths >= min(room.asked, CUDA_RAYS) else None
    budget = min(room.budget, int(free_memory(scene.device) * ROOM_SHARE) // CUDA_WORKERS)
    if room.asked * room.path_bytes > budget:
        return None
    most = min(max(areas) * sample_count, CUDA_RAYS_MOST)
    paths = max(room.asked, reduced_path_count(most, room.path_bytes, budget))
    return replace(room, asked=paths, paths=paths)


def _room(
    scene: DeviceScene, frame: Frame, settings: RenderSettings, areas: Sequence[int], sample_count: int, workers: int
) -> _Room:
    """What there is room for with so many `workers`."""
    device, in_tiles = scene.device, in_image_tiles(scene)
    unfiltered = in_tiles and scene.tracing.method is not Method.PAGED and not scene.features.texture_levels
    alive = paths_a_worker(settings, workers, device.is_cuda, brings_in(scene), unfiltered)
    asked = min(alive, max(areas) * sample_count)  # no tile needs more paths than it has samples
    each = path_bytes(scene, frame, settings, asked)
    layout, slots, slot_bytes = layout_of(frame.passes, frame.transparent), 0, 0  # of tiles of images
    if in_tiles:
        slots = tile_slots_of(scene.images.tiled, scene.image_budget, scene.images.bytes, workers, scene.tiles_least)
        slot_bytes = scene.images.tiled.slot_bytes
    # sums of finished tiles stay on a CUDA device until the film is asked for them
    pixels = -(-sum(areas) // workers) if device.is_cuda else max(areas)
    tile_bytes = pixels * (layout.count * WINDOW_DIGITS + 1) * 8
    if settings.half_count == 2:
        tile_bytes *= 3  # of both halves, and of their sum while a picture is made of it
    if settings.is_adaptive:
        tile_bytes += LOOK_BYTES * pixels
    sorting = order_bytes(scene.tracing.sort_mode(settings), asked, device.is_cuda)
    if scene.hits_sorted_by(settings):
        sorting += hit_order_bytes(asked)
    other = tile_bytes + slots * slot_bytes + sorting + SPILL_BYTES
    budget = max(0, int(free_memory(device) * PATH_MEMORY_SHARE) // workers - other)
    count = reduced_path_count(asked, each, budget)
    return _Room(workers, asked, count, each, other_bytes=other, budget=budget, slots=slots)


def worker_class(settings: RenderSettings) -> type[TileIntegrator]:
    """What workers are, by the setting `schedule`."""
    if settings.schedule == "STREAMING":
        from ..streaming.integrator import StreamingIntegrator  # other renders import none of it

        return StreamingIntegrator
    return TileIntegrator


def fewer_alive(ray_count: int, workers: int, areas: Sequence[int], sample_count: int) -> str | None:
    """Why fewer paths are alive than `ray_count` asks for (0: nothing is asked for); None where tiles of so many pixels
    have enough.
    """
    most = min(workers * max(areas), sum(areas)) * sample_count
    # what is left over where workers share them counts for nothing
    if ray_count // workers * workers <= most:
        return None
    samples = f"{sample_count:,} sample{'s' * (sample_count > 1)}"
    reason = f"ray_count {ray_count}: {most:,} are alive at most, because "
    if sum(areas) <= workers * max(areas):
        return f"{reason}the picture's {sum(areas):,} pixels have no more at {samples}"
    at_once = f", and {workers} tiles are rendered at once" if workers > 1 else ""
    return (
        f"{reason}a tile of {max(areas):,} pixels has {max(areas) * sample_count:,} at {samples}{at_once}; raise "
        "tile_size"
    )


def path_bytes(scene: DeviceScene, frame: Frame, settings: RenderSettings, path_count: int) -> int:
    """Device memory of one of `path_count` paths alive, with all that its tracer and counters keep of it [bytes]."""
    features, tracing = scene.features, scene.tracing
    arrays = array_features(features, scene.shading)
    size = bytes_per_path(features, tracing.method is Method.REFERENCE, arrays)
    size += tracer_bytes_per_path(scene, settings, path_count)
    return size + counter_bytes_per_path(tracing.counters(settings, frame.passes), features.shadow_rays)
