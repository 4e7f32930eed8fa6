"""Stage: finished paths go to the film, and their slots are free again."""

from __future__ import annotations

import functools

import warp as wp

from ...film import ChannelLayout
from ...film.sums import add_wide, add_window
from ...film.tile import FilmTile
from ...kernel import KERNEL_OPTIONS
from ..rays import Paths


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
