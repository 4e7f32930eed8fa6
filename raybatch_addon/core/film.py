"""The film: exact sums of samples, per pixel and channel.

A pixel's sum is kept as a fixed-point number cut into signed 64-bit *digits* of 32 bits each (a small
"superaccumulator", Kulisch 1971; Collange et al. 2015). A float32 is split over at most two digits, and
adding is integer addition: exact, without carries, and independent of the order of arrival. Films of any
partition of the samples therefore merge to the bits of one render.

Most pictures need four digits, 2^-96 to 2^32 (the *window*). A sample that does not fit is set aside and added to a
second set of ten digits that covers all of float32 (the *wide* digits), which is allocated when the first such sample turns up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from .errors import RayBatchError
from .kernel import KERNEL_OPTIONS
from .scene.description import Frame

# Digit k of the wide digits counts units of 2^(32 k - 160): bits 2^-160 to 2^160 hold 2^31 sums of any float32.
WIDE_DIGITS = 10
# The window is the wide digits 2 to 5.
WINDOW_FIRST = 2
WINDOW_DIGITS = 4

# Channels of every pass. The first sample alone decides "Depth" and "Position" (an average of them means nothing).
PASSES: dict[str, int] = {"Combined": 4, "Depth": 1, "Position": 3, "Normal": 3}
FIRST_SAMPLE_PASSES = ("Depth", "Position")


@dataclass(frozen=True)
class ChannelLayout:
    """Where the summed passes lie among the channels of a pixel's sums."""

    transparent: bool  # alpha is summed too; otherwise it is 1
    normal: bool

    @property
    def count(self) -> int:
        """Channels of a pixel."""
        return 3 + self.transparent + 3 * self.normal

    def span(self, name: str) -> slice:
        """Channels of the pass `name`."""
        colour = 3 + self.transparent
        return slice(0, colour) if name == "Combined" else slice(colour, colour + 3)


def layout_of(passes: tuple[str, ...], transparent: bool) -> ChannelLayout:
    """The layout for these passes."""
    return ChannelLayout(transparent, "Normal" in passes)


@wp.func
def digit_unit(k: int) -> wp.float64:
    """Value of one unit of wide digit `k`: 2^(32 k - 160)."""
    unit = wp.float64(1.0)
    for _ in range(k, 5):
        unit = unit * wp.float64(2.3283064365386963e-10)  # 2^-32
    for _ in range(5, k):
        unit = unit * wp.float64(4294967296.0)  # 2^32
    return unit


@wp.func
def add_window(digits: wp.array2d(dtype=wp.int64), index: int, value: float) -> bool:
    """Add `value` to the window digits of `index`; False, and nothing added, when it does not fit."""
    x = wp.float64(value)
    if wp.abs(x) >= wp.float64(4294967296.0):
        return False
    # float32 has 24 significant bits, so each step below is exact in float64
    rest = x * wp.float64(79228162514264337593543950336.0)  # 2^96
    if wp.trunc(rest) != rest:
        return False
    for i in range(wp.static(WINDOW_DIGITS)):
        digit = wp.trunc(x)
        if digit != wp.float64(0.0):
            wp.atomic_add(digits, wp.static(WINDOW_DIGITS - 1) - i, index, wp.int64(digit))
        x = (x - digit) * wp.float64(4294967296.0)
    return True


@wp.func
def add_wide(digits: wp.array2d(dtype=wp.int64), index: int, value: float):
    """Add any finite `value` to the wide digits of `index`."""
    x = wp.float64(value)
    for i in range(wp.static(WIDE_DIGITS)):
        k = wp.static(WIDE_DIGITS) - 1 - i
        unit = digit_unit(k)
        digit = wp.trunc(x / unit)
        if digit != wp.float64(0.0):
            wp.atomic_add(digits, k, index, wp.int64(digit))
            x = x - digit * unit


def rounded_sums(window: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """Sums rounded once to the nearest float64: what `math.fsum` gives for the samples.

    Args:
        window: int64, shape [WINDOW_DIGITS, n].
        wide: int64, shape [WIDE_DIGITS, n] or [0, any].

    Returns:
        float64, shape [n].
    """
    lowest, low, middle, high = normalised(window)
    # Below 2^20 the two upper digits are exact in float64 together, and adding the next one rounds once. With at least 55
    # bits there, the lowest digit matters only by being 0 or not: a sticky bit.
    upper = high.astype(np.float64) * 2.0**32 + middle
    sticky = low | (lowest != 0)
    sums = (upper * 2.0**32 + sticky) * 2.0**-64
    hard = (np.abs(high) >= 2**20) | ((lowest != 0) & (np.abs(upper) < 2.0**23))
    if len(wide):
        hard |= (wide != 0).any(0)
    for i in np.flatnonzero(hard).tolist():
        digits = [int(d) for d in wide[:, i]] if len(wide) else [0] * WIDE_DIGITS
        for k in range(WINDOW_DIGITS):
            digits[WINDOW_FIRST + k] += int(window[k, i])
        # Python rounds the quotient of two integers correctly
        total = sum(digit << (32 * k) for k, digit in enumerate(digits))
        sums[i] = total / (1 << 160)
    return sums


def means_of(window: np.ndarray, wide: np.ndarray, counts: np.ndarray, channels: int) -> np.ndarray:
    """Means of the samples, float32, shape [pixels * channels]; 0 where a pixel has none."""
    sums = rounded_sums(window, wide)
    return (sums / np.repeat(np.maximum(counts, 1), channels)).astype(np.float32)


def split_passes(
    names: tuple[str, ...], layout: ChannelLayout, means: np.ndarray, first: dict[str, np.ndarray], shape: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Passes by name, shape [height, width, channels], from the means of the summed channels."""
    means = means.reshape(*shape, layout.count)
    passes = {}
    for name in names:
        if name in first:
            passes[name] = first[name].reshape(*shape, PASSES[name])
            continue
        values = means[..., layout.span(name)]
        if name == "Combined" and not layout.transparent:
            values = np.concatenate([values, np.ones((*shape, 1), np.float32)], axis=-1)
        passes[name] = np.ascontiguousarray(values)
    return passes


def no_wide() -> np.ndarray:
    """Wide digits of a film that needed none."""
    return np.zeros((0, 0), np.int64)


@dataclass
class ExactSums:
    """Exact sums of all summed channels over a region."""

    window: np.ndarray  # int64, shape [WINDOW_DIGITS, pixel_count * channels]
    wide: np.ndarray  # int64, shape [WIDE_DIGITS or 0, pixel_count * channels]
    channels: int  # of a pixel

    @staticmethod
    def zeros(pixel_count: int, channels: int) -> ExactSums:
        """Sums of nothing."""
        return ExactSums(np.zeros((WINDOW_DIGITS, pixel_count * channels), np.int64), no_wide(), channels)

    def sums(self) -> np.ndarray:
        """The sums rounded once to float64, shape [pixel_count, channels]; equal to `math.fsum` of the samples."""
        return rounded_sums(self.window, self.wide).reshape(-1, self.channels)

    def add(self, other: ExactSums) -> ExactSums:
        """The sums of both; exact."""
        wide = self.wide if len(self.wide) else other.wide
        if len(self.wide) and len(other.wide):
            wide = normalised(self.wide + other.wide)
        return ExactSums(normalised(self.window + other.window), wide.copy(), self.channels)


def normalised(digits: np.ndarray) -> np.ndarray:
    """The same numbers with every digit but the highest in 0..2^32-1, so that further sums cannot overflow."""
    result = digits.copy()
    for k in range(len(result) - 1):
        carry = result[k] >> 32
        result[k] -= carry << 32
        result[k + 1] += carry
    return result


@dataclass
class Film:
    """The result of a render: passes of the rendered region, bottom row first, and how they came about."""

    width: int  # of the full frame [pixels]
    height: int
    region: tuple[int, int, int, int]  # x0, y0, x1, y1 [pixels]
    pass_names: tuple[str, ...]
    layout: ChannelLayout
    sums: ExactSums
    counts: np.ndarray  # samples of each pixel, int64, shape [region pixels]
    first: dict[str, np.ndarray]  # first-sample passes, float32, shape [region pixels * channels]
    complete: bool = True  # every sample asked for is there
    statistics: dict[str, Any] = field(default_factory=dict)
    resume_state: Any = None  # what `Session.render(resume=...)` needs; None when complete

    @staticmethod
    def empty(frame: Frame) -> Film:
        """A film of `frame` without samples."""
        x0, y0, x1, y1 = frame.region
        layout = layout_of(frame.passes, frame.transparent)
        pixel_count = (x1 - x0) * (y1 - y0)
        first = {n: np.zeros(pixel_count * PASSES[n], np.float32) for n in frame.passes if n in FIRST_SAMPLE_PASSES}
        return Film(
            frame.width, frame.height, frame.region, tuple(frame.passes), layout,
            ExactSums.zeros(pixel_count, layout.count), np.zeros(pixel_count, np.int64), first,
        )  # fmt: skip

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the region [pixels]."""
        x0, y0, x1, y1 = self.region
        return y1 - y0, x1 - x0

    @property
    def sample_count(self) -> int:
        """Samples of the pixel that has fewest."""
        return int(self.counts.min(initial=np.iinfo(np.int64).max)) if self.counts.size else 0

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """Linear float32 arrays by name, shape [region height, region width, channels]."""
        means = means_of(self.sums.window, self.sums.wide, self.counts, self.layout.count)
        return split_passes(self.pass_names, self.layout, means, self.first, self.shape)

    def add_tile(self, x: int, y: int, tile: Film) -> None:
        """Add the samples of `tile`, a film of the pixels whose bottom left is frame pixel (x, y)."""
        height, width = tile.shape
        place, channels = self._place(x, y, width, height), self.layout.count
        if len(tile.sums.wide) and not len(self.sums.wide):
            self.sums.wide = np.zeros((WIDE_DIGITS, self.sums.window.shape[1]), np.int64)
        for mine, theirs in ((self.sums.window, tile.sums.window), (self.sums.wide, tile.sums.wide)):
            if len(theirs):
                cells = mine.reshape(len(mine), -1, channels)
                cells[:, place] = normalised(cells[:, place] + theirs.reshape(len(mine), -1, channels))
        self.counts[place] += tile.counts
        for name, values in tile.first.items():
            self.first[name].reshape(-1, PASSES[name])[place] += values.reshape(-1, PASSES[name])

    def part(self, x: int, y: int, width: int, height: int) -> dict[str, np.ndarray]:
        """`passes` of the rectangle whose bottom left is frame pixel (x, y)."""
        place, channels = self._place(x, y, width, height), self.layout.count

        def cells(sums: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(sums.reshape(len(sums), -1, channels)[:, place].reshape(len(sums), -1))

        wide = cells(self.sums.wide) if len(self.sums.wide) else no_wide()
        means = means_of(cells(self.sums.window), wide, self.counts[place], channels)
        first = {name: values.reshape(-1, PASSES[name])[place] for name, values in self.first.items()}
        return split_passes(self.pass_names, self.layout, means, first, (height, width))

    def _place(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        rows = np.arange(y - self.region[1], y - self.region[1] + height)
        return (rows[:, None] * self.shape[1] + np.arange(width) + (x - self.region[0])).ravel()

    def merge(self, other: Film) -> Film:
        """The film of both films' samples, bit for bit that of one render; they must show the same region and passes."""
        if (self.width, self.height, self.region, self.pass_names, self.layout) != (
            other.width, other.height, other.region, other.pass_names, other.layout,
        ):  # fmt: skip
            raise RayBatchError("these films cannot be merged: they differ in size, region or passes; render both alike")
        return Film(
            self.width, self.height, self.region, self.pass_names, self.layout,
            sums=self.sums.add(other.sums),
            counts=self.counts + other.counts,
            # of a pixel that has its first sample in both films, this one's counts
            first={name: np.where(self.first[name] != 0, self.first[name], other.first[name]) for name in self.first},
            complete=self.complete and other.complete,
            statistics=dict(self.statistics),
        )  # fmt: skip

    def save_npz(self, path: str | Path) -> None:
        """Write the passes as arrays by name, linear float32 [height, width, channels], bottom row first."""
        with open(path, "wb") as file:
            np.savez_compressed(file, **self.passes)
