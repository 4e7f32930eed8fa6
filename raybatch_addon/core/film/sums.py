"""Exact sums of samples, per pixel and channel.

A pixel's sum is kept as a fixed-point number cut into signed 64-bit *digits* of 32 bits each (a small
"superaccumulator", Kulisch 1971; Collange et al. 2015). A float32 is split over at most two digits, and
adding is integer addition: exact, without carries, and independent of the order of arrival. Films of any
partition of the samples therefore merge to the bits of one render.

Most pictures need four digits, 2^-96 to 2^32 (the *window*). A sample that does not fit is set aside and added to a
second set of ten digits that covers all of float32 (the *wide* digits), which is allocated when the first such sample
turns up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

# Digit k of the wide digits counts units of 2^(32 k - 160): bits 2^-160 to 2^160 hold 2^31 sums of any float32.
WIDE_DIGITS = 10
# The window is the wide digits 2 to 5.
WINDOW_FIRST = 2
WINDOW_DIGITS = 4
# The highest `window_place` of a significand, of 24 bits, that ends within it
PLACE_MOST = wp.constant(32 * WINDOW_DIGITS - 24)


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
def window_place(value: float) -> int:
    """Where the lowest bit of a float32's significand lies in the window, whose own is 0; below 0 or above
    `PLACE_MOST`: part of it may lie outside.
    """
    return int((wp.cast(value, wp.uint32) >> wp.uint32(23)) & wp.uint32(255)) - 54


@wp.func
def fits_window(value: float) -> bool:
    """Whether the window's digits can hold `value` (`add_window`)."""
    place = window_place(value)
    if place >= 0 and place <= PLACE_MOST:
        return True
    scaled = wp.float64(value) * wp.float64(79228162514264337593543950336.0)  # 2^96
    return wp.abs(value) < 4294967296.0 and wp.trunc(scaled) == scaled


@wp.func
def add_window(digits: wp.array2d(dtype=wp.int64), index: int, value: float) -> bool:
    """Add `value` to the window digits of `index`; False, and nothing added, when it does not fit."""
    if value == 0.0:
        return True
    place = window_place(value)
    if place >= 0 and place <= PLACE_MOST:
        bits = wp.cast(value, wp.uint32)
        significand = wp.int64((bits & wp.uint32(0x7FFFFF)) | wp.uint32(0x800000)) << wp.int64(place & 31)
        low = significand & wp.int64(0xFFFFFFFF)
        high = significand >> wp.int64(32)
        if value < 0.0:
            low = -low
            high = -high
        k = place >> 5
        wp.atomic_add(digits, k, index, low)
        if high != wp.int64(0):
            wp.atomic_add(digits, k + 1, index, high)
        return True
    if not fits_window(value):
        return False
    x = wp.float64(value)  # has 24 significant bits, so each step below is exact
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
    # Below 2^20 the two upper digits are exact in float64 together, and adding the next one rounds once. With at least
    # 55 bits there, the lowest digit matters only by being 0 or not: a sticky bit.
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
