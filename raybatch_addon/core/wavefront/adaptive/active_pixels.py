"""The pixels of a render that still get samples: who they are on the host, and lists of them on the device."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...film import Film
from ...film.tile import FinishedTile
from ...native.structs import copied_to, to_numpy
from ..scheduler import Rectangle
from ..stages.generate import pixel_in_blocks
from .noise import NoisePart, row_sums_kernel, sample_noise_kernel, stop_kernel


@wp.kernel(**KERNEL_OPTIONS)
def flag_active_kernel(
    stopped: wp.array(dtype=int), width: int, tile_width: int, tile_height: int, corner: int, flags: wp.array(dtype=int)
):
    """1 for each pixel of a tile that gets samples, in the order in which pixels are walked, else 0."""
    i = wp.tid()
    place = pixel_in_blocks(i, tile_width, tile_height)
    flags[i] = int(0)
    if stopped[corner + place[1] * width + place[0]] == 0:
        flags[i] = 1


@wp.kernel(**KERNEL_OPTIONS)
def list_active_kernel(flags: wp.array(dtype=int), ends: wp.array(dtype=int), active: wp.array(dtype=int)):
    """The places that are flagged; `ends` is the inclusive scan of the flags."""
    i = wp.tid()
    if flags[i] != 0:
        active[ends[i] - 1] = i


ADAPTIVE_KERNELS = (sample_noise_kernel, row_sums_kernel, stop_kernel, flag_active_kernel, list_active_kernel)


@dataclass(frozen=True)
class HalfPictures:
    """The pictures of both halves in a rectangle."""

    rectangle: Rectangle
    colors: tuple[wp.array, wp.array]  # RGBA by half, vec4, shape [pixels]
    counts: tuple[wp.array, wp.array]  # samples by half, int64, shape [pixels]

    @staticmethod
    def of_tile(first: FinishedTile, second: FinishedTile) -> HalfPictures:
        """The pictures of one tile."""
        rectangle = Rectangle(first.x, first.y, first.width, first.height)
        return HalfPictures(rectangle, (first.colors(), second.colors()), (first.film.counts, second.film.counts))

    def on(self, device: wp.Device) -> HalfPictures:
        """These on `device`, where they are or copied."""
        colors, counts = (
            tuple(each if each.device == device else copied_to(each, device) for each in arrays)
            for arrays in (self.colors, self.counts)
        )
        return HalfPictures(self.rectangle, colors, counts)

    @staticmethod
    def of_film(film: Film, device: wp.Device) -> HalfPictures:
        """The pictures of a whole film, which has halves."""
        x0, y0, x1, y1 = film.region
        colors = [np.ascontiguousarray(half.colors).reshape(-1, 4) for half in film.halves]
        return HalfPictures(
            Rectangle(x0, y0, x1 - x0, y1 - y0),
            tuple(wp.array(each, dtype=wp.vec4, device=device) for each in colors),
            tuple(wp.array(half.counts, dtype=wp.int64, device=device) for half in film.halves),
        )


@dataclass
class ActivePixels:
    """Which pixels of a region get samples. It is a function of the film at each look, and travels on the host."""

    region: tuple[int, int, int, int]  # x0, y0, x1, y1 [pixels]
    threshold: float
    # samples that a pixel had when its sampling ended, 0 for those that go on; int32, shape [height, width]
    stopped: np.ndarray
    looks: list[dict[str, Any]] = field(default_factory=list)  # what each look found, for statistics

    @staticmethod
    def all_of(region: tuple[int, int, int, int], threshold: float) -> ActivePixels:
        """Every pixel goes on."""
        x0, y0, x1, y1 = region
        return ActivePixels(region, threshold, np.zeros((y1 - y0, x1 - x0), np.int32))

    @staticmethod
    def after(film: Film, samples: int, threshold: float, device: wp.Device) -> ActivePixels:
        """Pixels that go on after a look at `film`, which has all samples up to `samples` of every pixel that went on
        until then.
        """
        active = ActivePixels.all_of(film.region, threshold)
        counts = film.counts.reshape(active.stopped.shape)
        active.stopped[:] = np.where(counts < samples, counts, 0)
        active.look([HalfPictures.of_film(film, device)], samples, device)
        return active

    def copy(self) -> ActivePixels:
        """One that changes apart from this one."""
        return ActivePixels(self.region, self.threshold, self.stopped.copy(), list(self.looks))

    @property
    def share(self) -> float:
        """Share of the pixels that go on."""
        return 1.0 - int(np.count_nonzero(self.stopped)) / self.stopped.size

    def counts(self, done: int) -> np.ndarray:
        """Samples of each pixel where those that go on have `done`; int64, shape [height, width]."""
        return np.where(self.stopped, self.stopped, np.int64(done))

    def look(self, pictures: Iterable[HalfPictures], samples: int, device: wp.Device) -> None:
        """End the sampling of pixels with little noise around them; `pictures` are of all pixels, after `samples`
        samples of those that went on.
        """
        height, width = self.stopped.shape
        noise = wp.zeros(self.stopped.size, dtype=float, device=device)
        for each in (each.on(device) for each in pictures):
            part = NoisePart()
            part.first, part.second = each.colors
            part.first_counts, part.second_counts = each.counts
            part.width, part.corner = each.rectangle.width, self._corner(each.rectangle)
            wp.launch(sample_noise_kernel, each.rectangle.pixel_count, [part, width, noise], device=device)
        sums = wp.empty(noise.size, dtype=wp.vec2, device=device)
        wp.launch(row_sums_kernel, noise.size, [noise, width, sums], device=device)
        stopped = wp.array(self.stopped.reshape(-1), dtype=int, device=device)
        rule = [sums, width, height, samples, self.threshold**2, stopped]
        wp.launch(stop_kernel, noise.size, rule, device=device)
        self.stopped = to_numpy(stopped).reshape(height, width)
        self.looks.append({"samples": samples, "pixels": self.stopped.size - int(np.count_nonzero(self.stopped))})

    def lists(self, tiles: Iterable[Rectangle], device: wp.Device) -> list[wp.array | None]:
        """The pixels of each tile that get samples, int32, as `active_number` takes them; None for all of them."""
        stopped = wp.array(self.stopped.reshape(-1), dtype=int, device=device)
        return [self._list(tile, stopped) for tile in tiles]

    def _list(self, tile: Rectangle, stopped: wp.array) -> wp.array | None:
        device, width = stopped.device, self.stopped.shape[1]
        flags, ends = (wp.empty(tile.pixel_count, dtype=int, device=device) for _ in range(2))
        place = [stopped, width, tile.width, tile.height, self._corner(tile), flags]
        wp.launch(flag_active_kernel, tile.pixel_count, place, device=device)
        wp.utils.array_scan(flags, ends, inclusive=True)
        count = int(to_numpy(ends[-1:])[0])
        if count == tile.pixel_count:
            return None
        active = wp.empty(count, dtype=int, device=device)
        wp.launch(list_active_kernel, tile.pixel_count, [flags, ends, active], device=device)
        return active

    def _corner(self, rectangle: Rectangle) -> int:
        """Place of its bottom left pixel among those of the region."""
        return (rectangle.y - self.region[1]) * self.stopped.shape[1] + rectangle.x - self.region[0]
