"""Samples of a film as arrays of a file, and back.

A sum is a whole number of units (`core/film/sums.py`), kept in two's complement as 32-bit words, the lowest first: five
words in units of 2^-96 where four digits hold it, and beside them eleven in units of 2^-160 for the few that need wide
digits. So a channel takes 20 bytes before compression, and its halves 40.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..film.channels import ChannelLayout
from ..film.host_samples import HostSamples
from ..film.layout import COST_PASSES, FIRST_SAMPLE_PASSES, channels_of
from ..film.mattes import Mattes
from ..film.sums import WIDE_DIGITS, WINDOW_DIGITS, ExactSums, no_wide, normalised
from ..scene.passes import matte_kinds

WINDOW_WORDS, WIDE_WORDS = WINDOW_DIGITS + 1, WIDE_DIGITS + 1
_MATTES = {"cell": np.int64, "identity": np.uint32, "weight": np.int64}


@dataclass(frozen=True)
class FilmPart:
    """The part of a film that samples are of: its region and passes."""

    region: tuple[int, int, int, int]  # x0, y0, x1, y1 [pixels]
    pass_names: tuple[str, ...]
    layout: ChannelLayout

    @property
    def rectangle(self) -> tuple[int, int, int, int]:
        """x, y, width, height of the region [pixels]."""
        x0, y0, x1, y1 = self.region
        return x0, y0, x1 - x0, y1 - y0

    @property
    def pixel_count(self) -> int:
        """Pixels of the region."""
        x0, y0, x1, y1 = self.region
        return (x1 - x0) * (y1 - y0)

    def pixels(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        """Numbers of the pixels of a rectangle of the frame, in the order of its rows."""
        x0, y0, x1, _ = self.region
        rows = np.arange(y - y0, y - y0 + height)
        return (rows[:, None] * (x1 - x0) + np.arange(width) + (x - x0)).ravel()


@dataclass(frozen=True)
class TileSamples:
    """Samples of a rectangle of the frame, which nobody changes any more."""

    rectangle: tuple[int, int, int, int]  # x, y, width, height [pixels]
    samples: HostSamples


def samples_as_arrays(part: FilmPart, tiles: Sequence[TileSamples]) -> dict[str, np.ndarray]:
    """Arrays by name of the samples of all `tiles`; pixels that have none are left out, but for their count of 0."""
    channels, kinds = part.layout.count, len(matte_kinds(part.pass_names))
    counts = np.zeros(part.pixel_count, np.int64)
    for tile in tiles:
        counts[part.pixels(*tile.rectangle)] = tile.samples.counts
    number = np.cumsum(counts > 0) - 1  # of each pixel that has samples
    sampled = int(np.count_nonzero(counts))
    window = np.zeros((WINDOW_WORDS, sampled, channels), np.uint32)
    first = {name: np.zeros((sampled, channels_of(name)), np.float32) for name in _named(part, FIRST_SAMPLE_PASSES)}
    cost = {name: np.zeros(sampled, np.int64) for name in _named(part, COST_PASSES)}
    wide_cells, wide, mattes = [np.zeros(0, np.int64)], [np.zeros((WIDE_WORDS, 0), np.uint32)], [Mattes()]
    for tile in tiles:
        samples, pixels = tile.samples, part.pixels(*tile.rectangle)
        has = samples.counts > 0
        to = number[pixels[has]]
        window[:, to] = _words(samples.sums.window).reshape(WINDOW_WORDS, -1, channels)[:, has]
        for name, values in first.items():
            values[to] = samples.first[name].reshape(-1, channels_of(name))[has]
        for name, sums in cost.items():
            sums[to] = samples.cost[name][has]
        if len(samples.sums.wide):
            used = np.flatnonzero(samples.sums.wide.any(0))
            wide_cells.append(pixels[used // channels] * channels + used % channels)
            wide.append(_words(samples.sums.wide[:, used]))
        mattes.append(samples.mattes.moved(pixels, kinds))
    together = {name: np.concatenate([getattr(each, name) for each in mattes]) for name in _MATTES}
    ordered = Mattes().plus(Mattes(**together))
    return {
        "counts": counts,
        "window": window.reshape(WINDOW_WORDS, -1),
        "wide_cells": np.concatenate(wide_cells),
        "wide": np.concatenate(wide, axis=1),
        **{f"first/{name}": values.reshape(-1) for name, values in first.items()},
        **{f"cost/{name}": sums for name, sums in cost.items()},
        **{f"mattes/{name}": getattr(ordered, name) for name in _MATTES},
    }


def samples_of_arrays(part: FilmPart, arrays: dict[str, np.ndarray]) -> HostSamples:
    """The inverse of `samples_as_arrays`; raises `ValueError`, `KeyError` or `IndexError` for other arrays."""
    pixels, channels = part.pixel_count, part.layout.count

    def array(name: str, dtype: type, *shape: int) -> np.ndarray:
        found = arrays[name]
        if found.dtype != dtype or found.ndim != len(shape) or any(n not in (m, -1) for n, m in _pairs(found, shape)):
            raise ValueError(f"{name} is {found.dtype} of shape {list(found.shape)}")
        return found

    counts = array("counts", np.int64, pixels)
    there = np.flatnonzero(counts)

    def spread(values: np.ndarray, width: int) -> np.ndarray:
        """`values` of the pixels that have samples, `width` each, spread over all pixels; 0 elsewhere."""
        if len(there) == pixels:
            return values
        whole = np.zeros((*values.shape[:-1], pixels, width), values.dtype)
        whole[..., there, :] = values.reshape(*values.shape[:-1], len(there), width)
        return whole.reshape(*values.shape[:-1], pixels * width)

    wide, cells = no_wide(), array("wide_cells", np.int64, -1)
    words = array("wide", np.uint32, WIDE_WORDS, len(cells))
    if len(cells):
        wide = np.zeros((WIDE_DIGITS, pixels * channels), np.int64)
        wide[:, cells] = _digits(words)
    mattes = [array(f"mattes/{name}", dtype, -1) for name, dtype in _MATTES.items()]
    if len({len(each) for each in mattes}) != 1:
        raise ValueError("mattes are of several lengths")
    window = array("window", np.uint32, WINDOW_WORDS, len(there) * channels)
    return HostSamples(
        ExactSums(spread(_digits(window), channels), wide, channels),
        counts,
        {
            name: spread(array(f"first/{name}", np.float32, len(there) * channels_of(name)), channels_of(name))
            for name in _named(part, FIRST_SAMPLE_PASSES)
        },
        {name: spread(array(f"cost/{name}", np.int64, len(there)), 1) for name in _named(part, COST_PASSES)},
        Mattes(*mattes),
    )


def _pairs(found: np.ndarray, shape: Sequence[int]) -> Iterable[tuple[int, int]]:
    """Lengths that are asked for, with those that there are; -1 asks for nothing."""
    return zip(shape, found.shape)


def _named(part: FilmPart, names: Sequence[str]) -> list[str]:
    return [name for name in part.pass_names if name in names]


def _words(digits: np.ndarray) -> np.ndarray:
    """uint32, shape [digits + 1, n], of digits, int64, shape [digits, n]."""
    whole = normalised(digits)
    words = np.empty((len(whole) + 1, whole.shape[1]), np.uint32)
    words[:-1] = whole & 0xFFFFFFFF
    words[-1] = whole[-1] >> 32 & 0xFFFFFFFF
    return words


def _digits(words: np.ndarray) -> np.ndarray:
    """The inverse of `_words`."""
    digits = words[:-1].astype(np.int64)
    digits[-1] |= words[-1].astype(np.int64) << 32
    return digits
