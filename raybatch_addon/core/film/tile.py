"""The film of one tile on the device, and its pictures.

The sums of a finished tile stay where they were made; what travels is the rounded picture. The sums follow when
somebody asks for them, to merge or to go on.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernel import KERNEL_OPTIONS
from .layout import COST_PASSES, FIRST_SAMPLE_PASSES, PASSES, ChannelLayout, mean_costs, split_passes
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


# Places for channels that are set aside. When they run out the paths that found none wait until there are wide digits
SPILL_PLACES = 1 << 16


class FilmTiles:
    """Makes the tiles of one worker; what is set aside at the window's ends has one place for all of them."""

    def __init__(
        self, layout: ChannelLayout, passes: tuple[str, ...], device: wp.Device, spill_count: wp.array, spill_places: int = SPILL_PLACES
    ):  # fmt: skip
        """`spill_count`, int32, shape [1], counts what is set aside: whole pixels, of which `spill_places` channels have a place."""
        self._layout, self._passes, self._device, self._spill_count = layout, passes, device, spill_count
        places = max(1, spill_places // layout.count) * layout.count
        self._spill_index = wp.zeros(places, dtype=int, device=device)
        self._spill_value = wp.zeros(places, dtype=float, device=device)

    def begin(self, pixel_count: int) -> FilmTile:
        """A black tile."""

        def zeros(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=self._device)

        tile = FilmTile()
        tile.window = zeros((WINDOW_DIGITS, pixel_count * self._layout.count), wp.int64)
        tile.wide = zeros((0, 0), wp.int64)
        tile.counts = zeros(pixel_count, wp.int64)
        tile.depth = zeros(pixel_count if "Depth" in self._passes else 0, float)
        tile.position = zeros(pixel_count if "Position" in self._passes else 0, wp.vec3)
        tile.invalid = zeros(1, int)
        tile.spill_index, tile.spill_value = self._spill_index, self._spill_value
        self._spill_count.zero_()
        tile.spill_count = self._spill_count
        return tile

    def take_spill(self, film: FilmTile, spilled: int) -> bool:
        """Add the `spilled` channels that were set aside to wide digits; whether some found no place, so that there is more to add."""
        if spilled == 0:
            return False
        if film.wide.shape[0] == 0:
            film.wide = wp.zeros((WIDE_DIGITS, film.window.shape[1]), dtype=wp.int64, device=self._device)
        places = film.spill_index.shape[0]
        wp.launch(add_spill_kernel, min(spilled, places), [film], device=self._device)
        film.spill_count.zero_()
        return spilled > places


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
    def resolve(film: FilmTile, combined: wp.array(dtype=wp.vec4), normal: wp.array(dtype=wp.vec3), beyond: wp.array(dtype=int)):
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
            normal[pixel] = wp.vec3(mean(film, pixel, first), mean(film, pixel, first + 1), mean(film, pixel, first + 2))

    return resolve


@dataclass(frozen=True)
class HostSamples:
    """Sums, counts and first samples in the host's memory."""

    sums: ExactSums
    counts: np.ndarray  # int64, shape [pixels]
    first: dict[str, np.ndarray]  # float32, shape [pixels * channels]
    cost: dict[str, np.ndarray]  # sums of cost passes, int64, shape [pixels]

    @property
    def single(self) -> dict[str, np.ndarray]:
        """Passes that are no means of summed channels, float32, shape [pixels * channels]."""
        return self.first | mean_costs(self.cost, self.counts)


class FinishedTile:
    """A tile whose samples are all there."""

    def __init__(
        self, place: tuple[int, int, int, int], film: FilmTile, layout: ChannelLayout, pass_names: tuple[str, ...], sample_count: int,
        cost: wp.array | None = None,
    ):  # fmt: skip
        """`place` is x, y, width, height in the frame [pixels], `sample_count` the paths in it, `cost` (int64, shape [cost passes, pixels])
        the sums of those cost passes that are in `pass_names`, in their order. The picture is fetched at once."""
        # the worker's own arrays, which the next tile needs and this one must not keep alive
        film.spill_index, film.spill_value = (wp.empty(0, dtype=dtype, device=film.window.device) for dtype in (int, float))
        self._cost = cost
        self._cost_names = tuple(name for name in pass_names if name in COST_PASSES)
        self.sample_count = sample_count
        self.x, self.y, self.width, self.height = place
        self.invalid = int(film.invalid.numpy()[0])
        self._film, self._layout = film, layout
        self._first_names = tuple(name for name in pass_names if name in FIRST_SAMPLE_PASSES)
        self.passes = self._picture(pass_names)

    def fetch(self) -> HostSamples:
        """What the pictures are made of."""
        film = self._film
        wide = film.wide.numpy() if film.wide.shape[0] else no_wide()
        return HostSamples(ExactSums(film.window.numpy(), wide, self._layout.count), film.counts.numpy(), self._first(), self._costs())

    def _costs(self) -> dict[str, np.ndarray]:
        return dict(zip(self._cost_names, self._cost.numpy())) if self._cost_names else {}

    def _first(self) -> dict[str, np.ndarray]:
        arrays = {"Depth": self._film.depth, "Position": self._film.position}
        return {name: arrays[name].numpy().reshape(-1) for name in self._first_names}

    def _picture(self, pass_names: tuple[str, ...]) -> dict[str, np.ndarray]:
        film, shape = self._film, (self.height, self.width)
        if film.wide.shape[0] == 0:
            device, pixels = film.window.device, self.width * self.height
            combined = wp.empty(pixels, dtype=wp.vec4, device=device)
            normal = wp.empty(pixels if self._layout.normal else 0, dtype=wp.vec3, device=device)
            beyond = wp.zeros(1, dtype=int, device=device)
            wp.launch(resolve_kernel(self._layout), pixels, [film, combined, normal, beyond], device=device)
            if beyond.numpy()[0] == 0:
                means = {"Combined": combined, "Normal": normal}
                single = self._first()
                if self._cost_names:
                    single |= mean_costs(self._costs(), film.counts.numpy())
                return {
                    name: (single[name] if name in single else means[name].numpy()).reshape(*shape, PASSES[name]) for name in pass_names
                }
        # sums of more bits than the kernel handles
        samples = self.fetch()
        means = means_of(samples.sums.window, samples.sums.wide, samples.counts, self._layout.count)
        return split_passes(pass_names, self._layout, means, samples.single, shape)
