"""When rays are generated, and in which tiles: pure policy, without Warp or a device."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ..settings.settings import RenderSettings

# Paths alive at once, by device, where `ray_count` is 0. A CPU wave stays within a core's share of the outer caches; a
# GPU needs some ten thousand threads many times over, so that a wave's tail does not leave it idle.
CPU_RAYS_A_WORKER = 1 << 15
CUDA_RAYS = 1 << 22
# Where no ray waits, a GPU has two workers, each with as many paths as this. Between turns the host takes as long
# however many paths there are: more of them make fewer turns, and while one worker waits the GPU has the other's
# launches. Renders of 3840 x 2160 pixels, 192 samples (H200; the demo, and a car) took 8.2 and 10.4 s with one worker
# of CUDA_RAYS paths, 7.7 and 9.9 s with one of 1 << 24, and 7.7 and 9.5 s with two; two of 1 << 21 took 8.6 and 11.7 s
CUDA_WORKERS, CUDA_RAYS_MOST = 2, 1 << 24
# Share of the free memory that their paths may take; where that is less than CUDA_RAYS each, there is one worker
ROOM_SHARE = 0.125
# Beyond memory every page that is brought in should serve many rays. But all of them are looked through for each: a
# render of 125 million triangles (H200, a tenth of them on the device) took 1.39 s with 34 million paths alive, and
# 1.59 s with 105 million. New paths begin where others end, so that few pages more are copied.
RAYS_MOST = {True: 1 << 25, False: 1 << 23}  # on CUDA; of a worker on the CPU
# The same for images in tiles that are looked up as they are, on CUDA: each batch of rays brings most of their tiles
# anew (H200, a quarter of 5.5 GB on the device, 512 samples: 2.28 s, and 2.75 s with half as many; where images are
# filtered 0.33 s and 0.28 s)
IMAGE_RAYS = 1 << 26
# Edges of tiles where `tile_size` is 0
CPU_TILE = 128
CUDA_TILE = 2048
# A turn takes a CPU worker about as long for some hundred paths as for one, so its tiles have this many if they can
CPU_TILE_PATHS_LEAST = 256
# Tiles of each CPU worker, about, where a render is cut into rounds
CUT_TILES_A_WORKER = 2
# Edge up to which tiles are large for that alone where they are shown after a sample: some tenths of a second of a core
CPU_STEP_TILE = 512
# Where a tile's last paths come to their end a GPU has little to do, so its tiles have this many paths if they can
CUDA_TILE_PATHS = 1 << 24
# Tiles of each of several CUDA devices, about, and the edge below which such tiles keep none of them busy
SHARED_TILES, SHARED_TILE_LEAST = 16, 256


@dataclass(frozen=True)
class Rectangle:
    """Pixels of the frame, from the bottom left."""

    x: int
    y: int
    width: int
    height: int

    @property
    def pixel_count(self) -> int:
        """Area [pixels]."""
        return self.width * self.height

    @property
    def box(self) -> tuple[int, int, int, int]:
        """x, y, width and height."""
        return self.x, self.y, self.width, self.height


@dataclass(frozen=True)
class WaterMarks:
    """How many paths a worker keeps alive."""

    path_count: int  # slots
    low: int  # new paths are generated below this many
    high: int  # and up to this many

    def to_generate(self, alive: int, remaining: int) -> int:
        """How many new paths to generate now, with `alive` under way and `remaining` not yet begun."""
        if alive and alive >= self.low:
            return 0
        return max(0, min(self.high - alive, remaining))


def water_marks(settings: RenderSettings, path_count: int) -> WaterMarks:
    """Water marks of a worker with `path_count` slots; at least one path is kept alive."""
    high = max(1, min(path_count, round(settings.ray_high_water * path_count)))
    low = max(1, min(high, round(settings.ray_low_water * path_count)))
    return WaterMarks(path_count, low, high)


def serves_many(paged: bool, in_tiles: bool, is_cuda: bool) -> bool:
    """Whether what is brought in is to serve many rays: pages of geometry, and images `in_tiles` on a GPU. A CPU has
    all of its images in memory anyway.
    """
    return paged or (in_tiles and is_cuda)


def paths_a_worker(
    settings: RenderSettings, workers: int, is_cuda: bool, many: bool = False, unfiltered: bool = False
) -> int:
    """Path slots of each worker; `many`: what is brought in, as pages of geometry, is to serve many; `unfiltered`: that
    is tiles of images alone, which have no levels.
    """
    if settings.ray_count:
        return max(1, settings.ray_count // workers)
    if many:
        return IMAGE_RAYS if unfiltered and is_cuda else RAYS_MOST[is_cuda]
    return CUDA_RAYS if is_cuda else CPU_RAYS_A_WORKER


def tile_edge(
    settings: RenderSettings, is_cuda: bool, width: int, height: int, workers: int = 1, many: bool = False
) -> int:
    """Edge of the tiles [pixels]. Where it is chosen here, at least four tiles cover a frame that can be cut so, unless
    it has next to no paths.

    On CUDA small work is one tile, and tiles shrink with the samples so that they come at some pace. Where what is
    brought in is to serve `many` rays, as pages of geometry are, each worker has one tile, if it is not too large: no
    more rays can be alive than a tile has.
    """
    if settings.tile_size:
        return settings.tile_size
    if many:
        shares = math.ceil(math.sqrt(width * height / workers))
        return min(CUDA_TILE, max(width, height) if workers == 1 else shares)
    quarter = max(
        1, min(-(-max(width, height) // 2), -(-min(width, height) // 2) if min(width, height) > 1 else 1 << 30)
    )
    if not is_cuda:
        fewest = math.ceil(math.sqrt(CPU_TILE_PATHS_LEAST / settings.sample_count))
        return min(CPU_TILE, max(quarter, min(fewest, max(width, height))))
    most = CUDA_TILE
    if workers > 1:
        most = min(most, max(SHARED_TILE_LEAST, math.ceil(math.sqrt(width * height / (SHARED_TILES * workers)))))
    if width * height * settings.sample_count <= CUDA_TILE_PATHS:
        return min(most, max(width, height))
    paced = math.ceil(math.sqrt(4 * CUDA_TILE_PATHS / settings.sample_count))
    return min(most, quarter, max(256, paced))


def round_tile_edge(
    settings: RenderSettings, is_cuda: bool, width: int, height: int, workers: int = 1, many: bool = False
) -> int:
    """The edge of tiles, as by `tile_edge`, for a render that is cut into rounds.

    Tiles come at the pace of rounds, of which the first have few samples. Each tile comes to its end in each round,
    which takes a CPU as long however few paths it has: tiles are large there.
    """
    edge = tile_edge(settings.replace(sample_count=1), is_cuda, width, height, workers, many)
    if is_cuda or settings.tile_size:
        return edge
    return max(edge, math.ceil(math.sqrt(width * height / (CUT_TILES_A_WORKER * workers))))


def step_tile_edge(
    settings: RenderSettings, is_cuda: bool, width: int, height: int, workers: int = 1, many: bool = False
) -> int:
    """The edge of tiles, as by `round_tile_edge`, for a render that shows the whole frame after a sample and refines
    it: large tiles would come late.
    """
    edge = round_tile_edge(settings, is_cuda, width, height, workers, many)
    return edge if is_cuda or settings.tile_size else min(edge, CPU_STEP_TILE)


def tiles(region: tuple[int, int, int, int], edge: int) -> Iterator[Rectangle]:
    """Tiles that cover `region`, from its top, where a viewer looks first, row by row."""
    x0, y0, x1, y1 = region
    for top in range(y1, y0, -edge):
        bottom = max(y0, top - edge)
        for x in range(x0, x1, edge):
            yield Rectangle(x, bottom, min(edge, x1 - x), top - bottom)


def reduced_path_count(path_count: int, bytes_a_path: int, budget: int) -> int:
    """Largest power-of-two part of `path_count` that fits `budget` bytes; 0 when not even one path fits."""
    while path_count > 1 and path_count * bytes_a_path > budget:
        path_count //= 2
    return path_count if path_count * bytes_a_path <= budget else 0
