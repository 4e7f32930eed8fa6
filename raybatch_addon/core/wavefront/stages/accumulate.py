"""Stage: finished paths go to the film, and their slots are free again."""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...film import ChannelLayout
from ...film.sums import add_wide, add_window, fits_window
from ...film.tile import FilmTile
from ..rays import Paths
from .generate import pixel_sample
from .work import TileWork


def accumulate_kernel(layout: ChannelLayout) -> wp.Kernel:
    """Kernel (work, paths, film, slots, count).

    Where there are no wide digits yet, paths for which there is no room among the channels that are set aside stay as
    they are: a second launch adds them, and no other, once there are wide digits.
    """
    return _accumulate_kernel(layout.kind)


@functools.cache
def _accumulate_kernel(layout: ChannelLayout) -> wp.Kernel:
    has_others, others_first = bool(layout.others), layout.others_first
    normal_first = layout.span("Normal").start if layout.normal else 0

    @wp.func
    def fits(paths: Paths, path: int) -> bool:
        radiance = paths.radiance[path]
        fits_all = fits_window(radiance[0]) and fits_window(radiance[1]) and fits_window(radiance[2])
        if wp.static(layout.transparent):
            fits_all = fits_all and fits_window(paths.alpha[path])
        if wp.static(layout.normal):
            normal = paths.normal[path]
            fits_all = fits_all and fits_window(normal[0]) and fits_window(normal[1]) and fits_window(normal[2])
        if wp.static(has_others):
            values = paths.passes[0].values
            for c in range(values.shape[0]):
                fits_all = fits_all and fits_window(values[c, path])
        return fits_all

    @wp.func
    def is_finite(paths: Paths, path: int) -> bool:
        radiance = paths.radiance[path]
        valid = wp.isfinite(radiance[0]) and wp.isfinite(radiance[1]) and wp.isfinite(radiance[2])
        if wp.static(layout.transparent):
            valid = valid and wp.isfinite(paths.alpha[path])
        if wp.static(layout.normal):
            normal = paths.normal[path]
            valid = valid and wp.isfinite(normal[0]) and wp.isfinite(normal[1]) and wp.isfinite(normal[2])
        if wp.static(has_others):
            values = paths.passes[0].values
            for c in range(values.shape[0]):
                valid = valid and wp.isfinite(values[c, path])
        return valid

    @wp.func
    def spill_entries(film: FilmTile, channels: int) -> int:
        """First of one path's entries among the channels that are set aside, one a channel; -1: there is no room."""
        capacity = film.spill_index.shape[0]
        entry = int(-1)
        if film.spill_count[0] <= capacity:  # else it says already that there is no room, and need not grow
            entry = wp.atomic_add(film.spill_count, 0, channels)
            if entry + channels > capacity:
                entry = -1
        return entry

    @wp.func
    def add(film: FilmTile, index: int, value: float, entry: int):
        left = value
        if add_window(film.window, index, value):
            left = 0.0
        elif film.wide.shape[0] > 0:
            add_wide(film.wide, index, value)
        if entry >= 0:
            film.spill_index[entry] = index
            film.spill_value[entry] = left

    @wp.kernel(**KERNEL_OPTIONS)
    def accumulate(
        work: TileWork, paths: Paths, film: FilmTile, slots: wp.array(dtype=int), count: wp.array(dtype=int)
    ):
        i = wp.tid()
        if i >= count[0]:
            return
        path = slots[i]
        if paths.status[path] == 0:
            return  # added by the launch before
        pixel = pixel_sample(work, paths.item[path]).index
        channels = others_first
        if wp.static(has_others):
            channels = others_first + paths.passes[0].values.shape[0]
        kept = fits(paths, path)
        if kept or is_finite(paths, path):
            entry = -channels  # below 0 for all channels: nothing is set aside
            if not kept and film.wide.shape[0] == 0:
                entry = spill_entries(film, channels)
                if entry < 0:
                    return
            radiance = paths.radiance[path]
            for c in range(3):
                add(film, pixel * channels + c, radiance[c], entry + c)
            if wp.static(layout.transparent):
                add(film, pixel * channels + 3, paths.alpha[path], entry + 3)
            if wp.static(layout.normal):
                normal = paths.normal[path]
                for c in range(3):
                    channel = normal_first + c
                    add(film, pixel * channels + channel, normal[c], entry + channel)
            if wp.static(has_others):
                values = paths.passes[0].values
                for c in range(values.shape[0]):
                    channel = others_first + c
                    add(film, pixel * channels + channel, values[c, path], entry + channel)
        else:
            wp.atomic_add(film.invalid, 0, wp.int64(1))
        if wp.static(has_others):
            values = paths.passes[0].values
            for c in range(values.shape[0]):
                values[c, path] = 0.0  # for the next path in this slot
        wp.atomic_add(film.counts, pixel, wp.int64(1))
        paths.status[path] = 0

    return accumulate
