"""The film of one tile on the device, and its pictures.

The sums of a finished tile stay where they were made, and the next round of samples adds to them; what travels is the
rounded picture. The sums follow when somebody asks for them, to merge or to go on.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..device.kernel import KERNEL_OPTIONS
from .layout import (
    COST_PASSES,
    FIRST_SAMPLE_PASSES,
    PASSES,
    SAMPLE_COUNT,
    ChannelLayout,
    mean_costs,
    sample_counts,
    split_passes,
)
from .sums import WIDE_DIGITS, WINDOW_DIGITS, ExactSums, add_wide, means_of, no_wide


@wp.func
def fits_window(value: float) -> bool:
    """Whether the window's digits can hold `value` (`add_window`)."""
    scaled = wp.float64(value) * wp.float64(79228162514264337593543950336.0)  # 2^96
    return wp.abs(value) < 4294967296.0 and wp.trunc(scaled) == scaled


@wp.struct
class FilmTile:
    """Sums and counts of one tile."""

    window: wp.array2d(dtype=wp.int64)  # shape [WINDOW_DIGITS, pixels * channels]
    wide: wp.array2d(dtype=wp.int64)  # shape [WIDE_DIGITS, pixels * channels], or [0, 0] while no sample needed it
    counts: wp.array(dtype=wp.int64)  # samples of each pixel
    depth: wp.array(dtype=float)  # of the pixel's first sample [m]
    position: wp.array(dtype=wp.vec3)  # of the pixel's first sample [m]
    invalid: wp.array(dtype=int)  # samples that were not finite and count as black, shape [1]
    # Channels that did not fit the window while there were no wide digits
    spill_index: wp.array(dtype=int)
    spill_value: wp.array(dtype=float)
    spill_count: wp.array(dtype=int)  # shape [1]


# Entries for channels that are set aside. When they run out the paths that found none wait until there are wide digits
SPILL_CAPACITY = 1 << 16


class FilmTiles:
    """Makes the tiles of one worker; all of them share the arrays of what is set aside at the window's ends."""

    def __init__(
        self,
        layout: ChannelLayout,
        passes: tuple[str, ...],
        device: wp.Device,
        spill_count: wp.array,
        spill_capacity: int = SPILL_CAPACITY,
    ):
        """`spill_count`, int32, shape [1], counts what is set aside: whole pixels, for which there are
        `spill_capacity` entries, one a channel.
        """
        self._layout, self._passes, self._device, self._spill_count = layout, passes, device, spill_count
        capacity = max(1, spill_capacity // layout.count) * layout.count
        self._spill_index = wp.zeros(capacity, dtype=int, device=device)
        self._spill_value = wp.zeros(capacity, dtype=float, device=device)

    def begin(self, pixel_count: int, earlier: FilmTile | None = None) -> FilmTile:
        """A black tile, or `earlier`, to which more samples are added; of invalid samples only those to come are
        counted.
        """
        if earlier is not None:
            tile = earlier
            tile.invalid.zero_()
        else:
            tile = _black_tile(self._layout.count * pixel_count, self._device)
            tile.counts = wp.zeros(pixel_count, dtype=wp.int64, device=self._device)
            tile.depth = wp.zeros(pixel_count if "Depth" in self._passes else 0, dtype=float, device=self._device)
            tile.position = wp.zeros(
                pixel_count if "Position" in self._passes else 0, dtype=wp.vec3, device=self._device
            )
        tile.spill_index, tile.spill_value = self._spill_index, self._spill_value
        self._spill_count.zero_()
        tile.spill_count = self._spill_count
        return tile

    def take_spill(self, film: FilmTile, spilled: int) -> bool:
        """Add the `spilled` channels that were set aside to wide digits; whether some found no entry, so that there is
        more to add.
        """
        if spilled == 0:
            return False
        if film.wide.shape[0] == 0:
            film.wide = wp.zeros((WIDE_DIGITS, film.window.shape[1]), dtype=wp.int64, device=self._device)
        capacity = film.spill_index.shape[0]
        wp.launch(add_spill_kernel, min(spilled, capacity), [film], device=self._device)
        film.spill_count.zero_()
        return spilled > capacity


def _black_tile(cell_count: int, device: wp.Device) -> FilmTile:
    """Sums of so many channels, without counts and without entries for what does not fit."""
    tile = FilmTile()
    tile.window = wp.zeros((WINDOW_DIGITS, cell_count), dtype=wp.int64, device=device)
    tile.wide = wp.zeros((0, 0), dtype=wp.int64, device=device)
    tile.invalid = wp.zeros(1, dtype=int, device=device)
    return tile


@wp.kernel(**KERNEL_OPTIONS)
def add_integers_kernel(
    first: wp.array(dtype=wp.int64), second: wp.array(dtype=wp.int64), result: wp.array(dtype=wp.int64)
):
    """The sums of two arrays: of digits, counts or costs."""
    i = wp.tid()
    result[i] = first[i] + second[i]


def _added(first: wp.array, second: wp.array) -> wp.array:
    """int64, of any shape; one of an empty shape counts as 0."""
    if first.size == 0 or second.size == 0:
        return second if first.size == 0 else first
    result = wp.empty(first.shape, dtype=wp.int64, device=first.device)
    wp.launch(
        add_integers_kernel, first.size, [first.flatten(), second.flatten(), result.flatten()], device=first.device
    )
    return result


@wp.kernel(**KERNEL_OPTIONS)
def add_spill_kernel(film: FilmTile):
    """Add what was set aside, now that there are wide digits."""
    i = wp.tid()
    if i < film.spill_count[0]:
        add_wide(film.wide, film.spill_index[i], film.spill_value[i])


@wp.func
def rounded_sum(window: wp.array2d(dtype=wp.int64), index: int) -> wp.float64:
    """The window's sum at `index`, rounded once to the nearest float64; its highest digit must be below 2^31."""
    d0 = window[0, index]
    d1 = window[1, index] + (d0 >> wp.int64(32))
    d2 = window[2, index] + (d1 >> wp.int64(32))
    d3 = window[3, index] + (d2 >> wp.int64(32))
    mask = wp.int64(0xFFFFFFFF)
    low = wp.uint64(((d1 & mask) << wp.int64(32)) | (d0 & mask))
    high = wp.uint64((d3 << wp.int64(32)) | (d2 & mask))
    negative = d3 < wp.int64(0)
    if negative:
        low = ~low + wp.uint64(1)
        high = ~high
        if low == wp.uint64(0):
            high = high + wp.uint64(1)
    if high == wp.uint64(0) and low == wp.uint64(0):
        return wp.float64(0.0)
    # the top bit goes to bit 63 of `high`; what is left below counts by being 0 or not, so that rounding happens once
    scale = wp.float64(2.3283064365386963e-10)  # 2^-32: value of the lowest bit of `high`
    if high == wp.uint64(0):
        high = low
        low = wp.uint64(0)
        scale = scale * wp.static(wp.float64(2.0**-64))
    for i in range(6):
        step = wp.static(32) >> i
        if (high >> wp.uint64(64 - step)) == wp.uint64(0):
            high = (high << wp.uint64(step)) | (low >> wp.uint64(64 - step))
            low = low << wp.uint64(step)
            scale = scale / wp.float64(wp.uint64(1) << wp.uint64(step))
    if low != wp.uint64(0):
        high = high | wp.uint64(1)
    result = wp.float64(high) * scale
    if negative:
        result = -result
    return result


@functools.cache
def resolve_kernel(layout: ChannelLayout) -> wp.Kernel:
    """Kernel (film, combined, normal, beyond): means of a tile's pixels; `beyond` counts sums that leave the window."""

    @wp.func
    def mean(film: FilmTile, pixel: int, channel: int) -> float:
        count = wp.float64(wp.max(film.counts[pixel], wp.int64(1)))
        return float(rounded_sum(film.window, pixel * wp.static(layout.count) + channel) / count)

    @wp.kernel(**KERNEL_OPTIONS)
    def resolve(
        film: FilmTile, combined: wp.array(dtype=wp.vec4), normal: wp.array(dtype=wp.vec3), beyond: wp.array(dtype=int)
    ):
        pixel = wp.tid()
        for channel in range(wp.static(layout.count)):
            # so high that carries from below could leave it
            if wp.abs(film.window[3, pixel * wp.static(layout.count) + channel]) >= wp.static(wp.int64(2**31 - 2**16)):
                wp.atomic_add(beyond, 0, 1)
        alpha = float(1.0)
        if wp.static(layout.transparent):
            alpha = mean(film, pixel, 3)
        combined[pixel] = wp.vec4(mean(film, pixel, 0), mean(film, pixel, 1), mean(film, pixel, 2), alpha)
        if wp.static(layout.normal):
            first = wp.static(layout.span("Normal").start)
            normal[pixel] = wp.vec3(
                mean(film, pixel, first), mean(film, pixel, first + 1), mean(film, pixel, first + 2)
            )

    return resolve


@dataclass(frozen=True)
class HostSamples:
    """Sums, counts and first samples in the host's memory."""

    sums: ExactSums
    counts: np.ndarray  # int64, shape [pixels]
    first: dict[str, np.ndarray]  # float32, shape [pixels * channels]
    cost: dict[str, np.ndarray]  # sums of cost passes, int64, shape [pixels]

    @staticmethod
    def zeros(pixel_count: int, channels: int, pass_names: tuple[str, ...]) -> HostSamples:
        """No samples of so many pixels, with `channels` summed channels each."""
        first = {
            name: np.zeros(pixel_count * PASSES[name], np.float32) for name in pass_names if name in FIRST_SAMPLE_PASSES
        }
        cost = {name: np.zeros(pixel_count, np.int64) for name in pass_names if name in COST_PASSES}
        return HostSamples(ExactSums.zeros(pixel_count, channels), np.zeros(pixel_count, np.int64), first, cost)

    def add(self, other: HostSamples) -> HostSamples:
        """The samples of both. Of a pixel that has its first sample in both, this one's counts."""
        return HostSamples(
            self.sums.add(other.sums),
            self.counts + other.counts,
            {name: np.where(values != 0, values, other.first[name]) for name, values in self.first.items()},
            {name: sums + other.cost[name] for name, sums in self.cost.items()},
        )

    def part(self, pixels: np.ndarray) -> HostSamples:
        """Those of some pixels, in the order of `pixels`."""
        channels = self.sums.channels

        def cells(sums: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(sums.reshape(len(sums), -1, channels)[:, pixels].reshape(len(sums), -1))

        wide = cells(self.sums.wide) if len(self.sums.wide) else no_wide()
        return HostSamples(
            ExactSums(cells(self.sums.window), wide if wide.any() else no_wide(), channels),
            self.counts[pixels],
            {name: values.reshape(-1, PASSES[name])[pixels].reshape(-1) for name, values in self.first.items()},
            {name: values[pixels] for name, values in self.cost.items()},
        )

    def single(self, pass_names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Those of the passes that are no means of summed channels, float32, shape [pixels * channels]."""
        return self.first | mean_costs(self.cost, self.counts) | sample_counts(pass_names, self.counts)


class FinishedTile:
    """A tile whose samples so far are all there."""

    def __init__(
        self,
        rectangle: tuple[int, int, int, int],
        film: FilmTile,
        layout: ChannelLayout,
        pass_names: tuple[str, ...],
        sample_count: int,
        cost: wp.array | None = None,
    ):
        """`rectangle` is x, y, width, height in the frame [pixels], `sample_count` the paths in it, `cost` (int64,
        shape [cost passes, pixels]) the sums of those cost passes that are in `pass_names`, in their order. The
        picture is fetched at once."""
        # the worker's own arrays, which the next tile needs and this one must not keep alive
        film.spill_index, film.spill_value = (
            wp.empty(0, dtype=dtype, device=film.window.device) for dtype in (int, float)
        )
        self.rectangle = rectangle
        self.film: FilmTile | None = film  # None: it is the sum of `halves`
        self.cost = cost
        self.halves: tuple[FinishedTile, FinishedTile] | None = None  # what it is the sum of
        self.sample_count = sample_count
        self.x, self.y, self.width, self.height = rectangle
        self.invalid = int(
            film.invalid.numpy()[0]
        )  # samples that were not finite, since the tile was begun or gone on with
        self._layout, self._pass_names = layout, pass_names
        self._cost_names = tuple(name for name in pass_names if name in COST_PASSES)
        self._first_names = tuple(name for name in pass_names if name in FIRST_SAMPLE_PASSES)
        self.passes = self._picture(pass_names)

    @staticmethod
    def sum_of(first: FinishedTile, second: FinishedTile) -> FinishedTile:
        """The tile of both halves of its samples; what only the first sample gives is that of `first`. Their sums stay
        apart.
        """
        film = FilmTile()
        film.window, film.wide = (
            _added(first.film.window, second.film.window),
            _added(first.film.wide, second.film.wide),
        )
        film.counts = _added(first.film.counts, second.film.counts)
        film.depth, film.position = first.film.depth, first.film.position
        film.invalid, film.spill_count = (wp.zeros(1, dtype=int, device=film.window.device) for _ in range(2))
        cost = _added(first.cost, second.cost) if first.cost is not None else None
        count = first.sample_count + second.sample_count
        tile = FinishedTile(first.rectangle, film, first._layout, first._pass_names, count, cost)
        tile.halves, tile.invalid = (first, second), first.invalid + second.invalid
        tile.film = tile.cost = None
        return tile

    @staticmethod
    def on_device(
        rectangle: tuple[int, int, int, int],
        samples: HostSamples,
        layout: ChannelLayout,
        pass_names: tuple[str, ...],
        device: wp.Device,
    ) -> FinishedTile:
        """`samples` as a tile on `device` that more can be added to."""
        film = _black_tile(0, device)
        film.window = wp.array(samples.sums.window, dtype=wp.int64, device=device)
        if len(samples.sums.wide):
            film.wide = wp.array(samples.sums.wide, dtype=wp.int64, device=device)
        film.counts = wp.array(samples.counts, dtype=wp.int64, device=device)
        film.depth = wp.array(samples.first.get("Depth", np.zeros(0, np.float32)), dtype=float, device=device)
        film.position = wp.array(
            samples.first.get("Position", np.zeros(0, np.float32)).reshape(-1, 3), dtype=wp.vec3, device=device
        )
        film.spill_count = wp.zeros(1, dtype=int, device=device)
        costs = [samples.cost[name] for name in pass_names if name in COST_PASSES]
        cost = wp.array(np.stack(costs), dtype=wp.int64, device=device) if costs else None
        return FinishedTile(rectangle, film, layout, pass_names, int(samples.counts.sum()), cost)

    def fetch(self) -> HostSamples:
        """What the pictures are made of."""
        if self.halves:
            return self.halves[0].fetch().add(self.halves[1].fetch())
        film = self.film
        wide = film.wide.numpy() if film.wide.shape[0] else no_wide()
        return HostSamples(
            ExactSums(film.window.numpy(), wide, self._layout.count), film.counts.numpy(), self._first(), self._costs()
        )

    def colors(self) -> wp.array:
        """RGBA of each pixel, as "Combined" shows it, vec4, shape [pixels], on the device that has the sums."""
        resolved = self._resolved()
        if resolved is not None:
            return resolved[0]
        pixels = np.ascontiguousarray(self.passes["Combined"], np.float32).reshape(-1, 4)
        return wp.array(pixels, dtype=wp.vec4, device=self.film.window.device)

    def _costs(self) -> dict[str, np.ndarray]:
        return dict(zip(self._cost_names, self.cost.numpy())) if self._cost_names else {}

    def _first(self) -> dict[str, np.ndarray]:
        arrays = {"Depth": self.film.depth, "Position": self.film.position}
        return {name: arrays[name].numpy().reshape(-1) for name in self._first_names}

    def _resolved(self) -> tuple[wp.array, wp.array] | None:
        """Means of the pixels on the device: RGBA and Normal; None where sums have more bits than the kernel
        handles.
        """
        film = self.film
        if film.wide.shape[0]:
            return None
        device, pixels = film.window.device, self.width * self.height
        combined = wp.empty(pixels, dtype=wp.vec4, device=device)
        normal = wp.empty(pixels if self._layout.normal else 0, dtype=wp.vec3, device=device)
        beyond = wp.zeros(1, dtype=int, device=device)
        wp.launch(resolve_kernel(self._layout), pixels, [film, combined, normal, beyond], device=device)
        return None if beyond.numpy()[0] else (combined, normal)

    def _picture(self, pass_names: tuple[str, ...]) -> dict[str, np.ndarray]:
        shape, resolved = (self.height, self.width), self._resolved()
        if resolved is not None:
            means = dict(zip(("Combined", "Normal"), resolved, strict=True))
            single = self._first()
            if self._cost_names or SAMPLE_COUNT in pass_names:
                counts = self.film.counts.numpy()
                single |= mean_costs(self._costs(), counts) | sample_counts(pass_names, counts)
            return {
                name: (single[name] if name in single else means[name].numpy()).reshape(*shape, PASSES[name])
                for name in pass_names
            }
        samples = self.fetch()
        means = means_of(samples.sums.window, samples.sums.wide, samples.counts, self._layout.count)
        return split_passes(pass_names, self._layout, means, samples.single(pass_names), shape)
