"""The film of one tile on the device, and its pictures.

The sums of a finished tile stay where they were made, and the next round of samples adds to them; what travels is the
rounded picture. The sums follow when somebody asks for them, to merge or to go on.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence

import numpy as np
import warp as wp

from ..device.kernel import KERNEL_OPTIONS
from ..native.structs import copied_by_host, struct_on, to_numpy
from ..scene.passes import matte_kinds
from .channels import ChannelLayout
from .host_samples import HostSamples
from .layout import (
    COST_PASSES,
    FIRST_SAMPLE_PASSES,
    SAMPLE_COUNT,
    channels_of,
    mean_costs,
    sample_counts,
    shown_first,
    shown_pass,
)
from .mattes import MatteEntry, Mattes, MatteTile, matte_tile, mattes_on_device
from .rounding import rounded_sum
from .sums import WIDE_DIGITS, WINDOW_DIGITS, ExactSums, add_wide, no_wide


@wp.struct
class FilmTile:
    """Sums and counts of one tile."""

    window: wp.array2d(dtype=wp.int64)  # shape [WINDOW_DIGITS, pixels * channels]
    wide: wp.array2d(dtype=wp.int64)  # shape [WIDE_DIGITS, pixels * channels], or [0, 0] while no sample needed it
    counts: wp.array(dtype=wp.int64)  # samples of each pixel
    depth: wp.array(dtype=float)  # of the pixel's first sample [m]
    position: wp.array(dtype=wp.vec3)  # of the pixel's first sample [m]
    object_index: wp.array(dtype=float)  # of the pixel's first sample
    material_index: wp.array(dtype=float)  # of the pixel's first sample
    mattes: MatteTile
    invalid: wp.array(dtype=wp.int64)  # samples that were not finite and count as black, shape [1]; the worker's
    # Channels that did not fit the window while there were no wide digits
    spill_index: wp.array(dtype=int)
    spill_value: wp.array(dtype=float)
    spill_count: wp.array(dtype=int)  # shape [1]


# Arrays of what the first sample of a pixel decides, by pass
FIRST_SAMPLE_ARRAYS = {name: name.lower().replace(" ", "_") for name in FIRST_SAMPLE_PASSES}
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
        self._mattes_aside: wp.array | None = None
        self._layout, self._passes, self._device, self._spill_count = layout, passes, device, spill_count
        capacity = max(1, spill_capacity // layout.count) * layout.count
        self._spill_index = wp.zeros(capacity, dtype=int, device=device)
        self._spill_value = wp.zeros(capacity, dtype=float, device=device)
        self._invalid = wp.zeros(1, dtype=wp.int64, device=device)

    @property
    def invalid_samples(self) -> int:
        """Samples of all tiles that were not finite and count as black; waits for the device."""
        return int(to_numpy(self._invalid)[0])

    def begin_render(self) -> None:
        """Invalid samples are counted from here on."""
        self._invalid.zero_()

    def begin(self, pixel_count: int, earlier: FilmTile | None = None) -> FilmTile:
        """A black tile, or `earlier`, to which more samples are added."""
        if earlier is not None:
            tile = earlier
        else:
            tile = _black_tile(self._layout.count * pixel_count, self._device)
            tile.counts = wp.zeros(pixel_count, dtype=wp.int64, device=self._device)
            for name, array in FIRST_SAMPLE_ARRAYS.items():
                dtype, count = FilmTile.vars[array].type.dtype, pixel_count if name in self._passes else 0
                setattr(tile, array, wp.zeros(count, dtype=dtype, device=self._device))
            tile.mattes = matte_tile(pixel_count, len(matte_kinds(self._passes)), self._device)
        tile.spill_index, tile.spill_value = self._spill_index, self._spill_value
        self._spill_count.zero_()
        tile.spill_count = self._spill_count
        tile.invalid = self._invalid
        if self._mattes_aside is not None:
            tile.mattes.aside, tile.mattes.aside_count = self._mattes_aside, self._mattes_aside_count
            self._mattes_aside_count.zero_()
        return tile

    def set_mattes_aside(self, matte_count: wp.array, path_count: int) -> None:
        """Where there are mattes, set aside what finds no slot: one weight of each kind for each of `path_count` paths.
        `matte_count`, int32, shape [1], counts them.
        """
        if kinds := len(matte_kinds(self._passes)):
            self._mattes_aside = wp.zeros(kinds * path_count, dtype=MatteEntry, device=self._device)
            self._mattes_aside_count = matte_count

    def mattes_aside(self, count: int) -> Mattes:
        """The `count` weights that found no slot, which are the caller's from now on."""
        if count == 0:
            return Mattes()
        entries = Mattes.of_entries(to_numpy(self._mattes_aside[:count]))
        self._mattes_aside_count.zero_()
        return entries

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


def resolve_kernel(layout: ChannelLayout) -> wp.Kernel:
    """Kernel (film, combined, normal, others): means of a tile's pixels, those of `ChannelLayout.others` as array2d
    [pixels, channels].
    """
    return _resolve_kernel(layout.kind)


@functools.cache
def _resolve_kernel(layout: ChannelLayout) -> wp.Kernel:
    others_first, has_others = layout.others_first, bool(layout.others)
    normal_first = layout.span("Normal").start if layout.normal else 0

    @wp.func
    def mean(film: FilmTile, pixel: int, cell: int) -> float:
        count = wp.float64(wp.max(film.counts[pixel], wp.int64(1)))
        return float(rounded_sum(film.window, film.wide, cell) / count)

    @wp.kernel(**KERNEL_OPTIONS)
    def resolve(
        film: FilmTile,
        combined: wp.array(dtype=wp.vec4),
        normal: wp.array(dtype=wp.vec3),
        others: wp.array2d(dtype=float),
    ):
        pixel = wp.tid()
        channels = others_first
        if wp.static(has_others):
            channels = others_first + others.shape[1]
        first = pixel * channels
        alpha = float(1.0)
        if wp.static(layout.transparent):
            alpha = mean(film, pixel, first + 3)
        combined[pixel] = wp.vec4(
            mean(film, pixel, first), mean(film, pixel, first + 1), mean(film, pixel, first + 2), alpha
        )
        if wp.static(layout.normal):
            x = first + normal_first
            normal[pixel] = wp.vec3(mean(film, pixel, x), mean(film, pixel, x + 1), mean(film, pixel, x + 2))
        if wp.static(has_others):
            for channel in range(others.shape[1]):
                others[pixel, channel] = mean(film, pixel, first + others_first + channel)

    return resolve


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
        mattes: Mattes | None = None,
    ):
        """`rectangle` is x, y, width, height in the frame [pixels], `sample_count` the paths in it, `cost` (int64,
        shape [cost passes, pixels]) the sums of those cost passes that are in `pass_names`, in their order, `mattes`
        those that are not in the slots of `film`."""
        # the worker's own arrays, which the next tile needs and this one must not keep alive
        film.spill_index, film.spill_value, film.spill_count, film.invalid = (
            wp.empty(0, dtype=dtype, device=film.window.device) for dtype in (int, float, int, wp.int64)
        )
        film.mattes.aside = wp.empty(0, dtype=MatteEntry, device=film.window.device)
        film.mattes.aside_count = wp.empty(0, dtype=int, device=film.window.device)
        self.mattes = mattes or Mattes()
        self.rectangle = rectangle
        self.film: FilmTile | None = film  # None: it is the sum of `halves`
        self.cost = cost
        self.halves: tuple[FinishedTile, FinishedTile] | None = None  # what it is the sum of
        self.sample_count = sample_count
        self.x, self.y, self.width, self.height = rectangle
        self._layout, self._pass_names = layout, pass_names
        self._cost_names = tuple(name for name in pass_names if name in COST_PASSES)
        self._first_names = tuple(name for name in pass_names if name in FIRST_SAMPLE_PASSES)
        self._passes: dict[str, np.ndarray] | None = None
        self._has_gone_on = False

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """The picture, made when it is first asked for. Raises `RuntimeError` where the tile has gone on since."""
        if self._passes is None and self._has_gone_on:
            raise RuntimeError(f"the tile {self.rectangle} got more samples before its picture was made")
        if self._passes is None:
            self._passes = self._picture(self._pass_names)
        return self._passes

    def go_on(self) -> FilmTile:
        """What more samples are added to from now on, of a tile that is no sum of halves."""
        self._has_gone_on = True
        return self.film

    @staticmethod
    def of_halves(halves: Sequence[FinishedTile]) -> FinishedTile:
        """The tile of all samples, with its picture and those of its halves, where they are in one half or in two."""
        for each in halves:
            _ = each.passes
        return halves[0] if len(halves) == 1 else FinishedTile.sum_of(*halves)

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
        for array in FIRST_SAMPLE_ARRAYS.values():
            setattr(film, array, getattr(first.film, array))
        film.mattes = matte_tile(0, 0, film.window.device)
        cost = _added(first.cost, second.cost) if first.cost is not None else None
        count = first.sample_count + second.sample_count
        mattes = first._all_mattes().plus(second._all_mattes())
        tile = FinishedTile(first.rectangle, film, first._layout, first._pass_names, count, cost, mattes)
        _ = tile.passes
        tile.halves = (first, second)
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
        for name, array in FIRST_SAMPLE_ARRAYS.items():
            dtype, values = FilmTile.vars[array].type.dtype, samples.first.get(name, np.zeros(0, np.float32))
            values = values.reshape(-1, 3) if dtype is wp.vec3 else values
            setattr(film, array, wp.array(values, dtype=dtype, device=device))
        costs = [samples.cost[name] for name in pass_names if name in COST_PASSES]
        cost = wp.array(np.stack(costs), dtype=wp.int64, device=device) if costs else None
        kinds = len(matte_kinds(pass_names))
        film.mattes, mattes = mattes_on_device(samples.mattes, len(samples.counts), kinds, device)
        return FinishedTile(rectangle, film, layout, pass_names, int(samples.counts.sum()), cost, mattes)

    def on(self, device: wp.Device) -> FinishedTile:
        """This tile where it is on `device`, else a copy there, as `copied`."""
        return self if self.film.window.device == device else self.copied(device)

    def copied(self, device: wp.Device) -> FinishedTile:
        """A copy on `device` to which more can be added, apart from this tile. Not of a sum of halves."""
        made = copy.copy(self)
        made.film = struct_on(self.film, device)
        made.cost = None if self.cost is None else copied_by_host(self.cost, device)
        return made

    def fetch(self) -> HostSamples:
        """What the pictures are made of."""
        if self.halves:
            return self.halves[0].fetch().add(self.halves[1].fetch())
        film = self.film
        wide = to_numpy(film.wide) if film.wide.shape[0] else no_wide()
        return HostSamples(
            ExactSums(to_numpy(film.window), wide, self._layout.count),
            to_numpy(film.counts),
            self._first(),
            self._costs(),
            self._all_mattes(),
        )

    def colors(self) -> wp.array:
        """RGBA of each pixel, as `Film.colors`, vec4, shape [pixels], on the device that has the sums."""
        return self._resolved()[0]

    def _costs(self) -> dict[str, np.ndarray]:
        return dict(zip(self._cost_names, to_numpy(self.cost))) if self._cost_names else {}

    def _all_mattes(self) -> Mattes:
        return Mattes.of_device(self.film.mattes).plus(self.mattes) if matte_kinds(self._pass_names) else Mattes()

    def _first(self) -> dict[str, np.ndarray]:
        return {name: to_numpy(getattr(self.film, FIRST_SAMPLE_ARRAYS[name])).reshape(-1) for name in self._first_names}

    def _resolved(self) -> tuple[wp.array, wp.array, wp.array]:
        """Means of the pixels on the device: RGBA, Normal and the others."""
        device, pixels = self.film.window.device, self.width * self.height
        combined = wp.empty(pixels, dtype=wp.vec4, device=device)
        normal = wp.empty(pixels if self._layout.normal else 0, dtype=wp.vec3, device=device)
        others_count = self._layout.others_count
        others = wp.empty((pixels if others_count else 0, others_count), dtype=float, device=device)
        wp.launch(resolve_kernel(self._layout), pixels, [self.film, combined, normal, others], device=device)
        return combined, normal, others

    def _picture(self, pass_names: tuple[str, ...]) -> dict[str, np.ndarray]:
        shape, single = (self.height, self.width), shown_first(self._first())
        combined, normal, others = (to_numpy(each) for each in self._resolved())
        means, first = {"Combined": combined, "Normal": normal}, self._layout.others_first
        for name in self._layout.others:
            span = self._layout.span(name)
            means[name] = others[:, span.start - first : span.stop - first]
        if self._cost_names or SAMPLE_COUNT in pass_names:
            counts = to_numpy(self.film.counts)
            single |= mean_costs(self._costs(), counts) | sample_counts(pass_names, counts)
        if matte_kinds(pass_names):
            single |= self._all_mattes().passes(pass_names, to_numpy(self.film.counts))
        pictures = {
            name: single[name] if name in single else shown_pass(name, means.__getitem__, self._layout)
            for name in pass_names
        }
        return {
            name: np.ascontiguousarray(pixels).reshape(*shape, channels_of(name)) for name, pixels in pictures.items()
        }
