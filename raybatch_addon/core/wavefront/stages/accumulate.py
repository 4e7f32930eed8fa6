"""Stage: finished paths go to the film, and their slots are free again."""

from __future__ import annotations

import functools

import warp as wp

from ...film import WIDE_DIGITS, WINDOW_DIGITS, ChannelLayout, add_wide, add_window
from ...kernel import KERNEL_OPTIONS
from ..rays import Paths


@wp.struct
class FilmTile:
    """The film of one tile on the device."""

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


def allocate_film_tile(pixel_count: int, path_count: int, layout: ChannelLayout, passes: tuple[str, ...], device) -> FilmTile:
    """A black tile, with room for what `path_count` paths may spill at once."""

    def zeros(shape, dtype):
        return wp.zeros(shape, dtype=dtype, device=device)

    tile = FilmTile()
    tile.window = zeros((WINDOW_DIGITS, pixel_count * layout.count), wp.int64)
    tile.wide = zeros((0, 0), wp.int64)
    tile.counts = zeros(pixel_count, wp.int64)
    tile.depth = zeros(pixel_count if "Depth" in passes else 0, float)
    tile.position = zeros(pixel_count if "Position" in passes else 0, wp.vec3)
    tile.invalid = zeros(1, int)
    tile.spill_index = zeros(path_count * layout.count, int)
    tile.spill_value = zeros(path_count * layout.count, float)
    tile.spill_count = zeros(1, int)
    return tile


@functools.cache
def accumulate_kernel(layout: ChannelLayout) -> wp.Kernel:
    """Kernel (paths, film, slots, count)."""
    channels = layout.count

    @wp.func
    def add(film: FilmTile, index: int, value: float):
        if not add_window(film.window, index, value):
            if film.wide.shape[0] > 0:
                add_wide(film.wide, index, value)
            else:
                spilled = wp.atomic_add(film.spill_count, 0, 1)
                film.spill_index[spilled] = index
                film.spill_value[spilled] = value

    @wp.kernel(**KERNEL_OPTIONS)
    def accumulate(paths: Paths, film: FilmTile, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
        i = wp.tid()
        if i >= count[0]:
            return
        path = slots[i]
        pixel = paths.pixel[path]
        radiance = paths.radiance[path]
        valid = wp.isfinite(radiance[0]) and wp.isfinite(radiance[1]) and wp.isfinite(radiance[2])
        if wp.static(layout.transparent):
            valid = valid and wp.isfinite(paths.alpha[path])
        if wp.static(layout.normal):
            normal = paths.normal[path]
            valid = valid and wp.isfinite(normal[0]) and wp.isfinite(normal[1]) and wp.isfinite(normal[2])
        if valid:
            for c in range(3):
                add(film, pixel * channels + c, radiance[c])
            if wp.static(layout.transparent):
                add(film, pixel * channels + 3, paths.alpha[path])
            if wp.static(layout.normal):
                for c in range(3):
                    add(film, pixel * channels + wp.static(layout.span("Normal").start) + c, normal[c])
        else:
            wp.atomic_add(film.invalid, 0, 1)
        wp.atomic_add(film.counts, pixel, wp.int64(1))
        paths.status[path] = 0

    return accumulate


@wp.kernel(**KERNEL_OPTIONS)
def add_spill_kernel(film: FilmTile):
    """Add what was set aside, now that there are wide digits."""
    i = wp.tid()
    if i < film.spill_count[0]:
        add_wide(film.wide, film.spill_index[i], film.spill_value[i])


def take_spill(film: FilmTile, spilled: int, device: wp.Device) -> None:
    """Give `film` wide digits and add the `spilled` channels to them."""
    if film.wide.shape[0] == 0:
        film.wide = wp.zeros((WIDE_DIGITS, film.window.shape[1]), dtype=wp.int64, device=device)
    wp.launch(add_spill_kernel, spilled, [film], device=device)
    film.spill_count.zero_()
