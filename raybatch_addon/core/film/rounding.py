"""Exact sums rounded on their device: as `sums.rounded_sums` does on the host, to the bit."""

from __future__ import annotations

import warp as wp

from .sums import WIDE_DIGITS, WINDOW_DIGITS, WINDOW_FIRST

_Digits = wp.types.vector(length=WIDE_DIGITS, dtype=wp.int64)
# From here on the window's highest digit may leave it by carries from below
_WINDOW_MOST = 2**31 - 2**16


@wp.func
def rounded_bits(high: wp.uint64, low: wp.uint64, unit: wp.float64) -> wp.float64:
    """`high` * 2^64 + `low` in units of `unit` / 2^64, rounded once to the nearest float64. The lowest bit of `low` may
    stand for any bits below it.
    """
    scale = unit
    if high == wp.uint64(0):
        high = low
        low = wp.uint64(0)
        scale = scale * wp.static(wp.float64(2.0**-64))
    if high == wp.uint64(0):
        return wp.float64(0.0)
    # the top bit goes to bit 63 of `high`; what is left below counts by being 0 or not, so that rounding happens once
    for i in range(6):
        step = wp.static(32) >> i
        if (high >> wp.uint64(64 - step)) == wp.uint64(0):
            high = (high << wp.uint64(step)) | (low >> wp.uint64(64 - step))
            low = low << wp.uint64(step)
            scale = scale / wp.float64(wp.uint64(1) << wp.uint64(step))
    if low != wp.uint64(0):
        high = high | wp.uint64(1)
    return wp.float64(high) * scale


@wp.func
def rounded_window(window: wp.array2d(dtype=wp.int64), index: int) -> wp.float64:
    """The window's sum at `index`, rounded; its highest digit must be below 2^31."""
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
    result = rounded_bits(high, low, wp.static(wp.float64(2.0**-32)))
    if negative:
        result = -result
    return result


@wp.func
def rounded_wide(window: wp.array2d(dtype=wp.int64), wide: wp.array2d(dtype=wp.int64), index: int) -> wp.float64:
    """The sum at `index` of the window and of the wide digits, where there are any, rounded."""
    digits = _Digits()
    if wide.shape[0] > 0:
        for k in range(wp.static(WIDE_DIGITS)):
            digits[k] = wide[k, index]
    for k in range(wp.static(WINDOW_DIGITS)):
        digits[wp.static(WINDOW_FIRST) + k] += window[k, index]
    mask = wp.int64(0xFFFFFFFF)
    for k in range(wp.static(WIDE_DIGITS - 1)):
        digits[k + 1] += digits[k] >> wp.int64(32)
        digits[k] = digits[k] & mask
    negative = digits[wp.static(WIDE_DIGITS - 1)] < wp.int64(0)
    if negative:
        for k in range(wp.static(WIDE_DIGITS)):
            digits[k] = -digits[k]
        for k in range(wp.static(WIDE_DIGITS - 1)):
            digits[k + 1] += digits[k] >> wp.int64(32)
            digits[k] = digits[k] & mask
    # the four highest digits from the first that is not 0, and whether anything is below
    high, low = wp.uint64(0), wp.uint64(0)
    unit, place = wp.static(wp.float64(2.0 ** (32 * (WIDE_DIGITS - 2) - 160))), int(0)
    for i in range(wp.static(WIDE_DIGITS)):
        digit = wp.uint64(digits[wp.static(WIDE_DIGITS - 1) - i])
        if place == 0 and digit == wp.uint64(0):
            unit = unit * wp.static(wp.float64(2.0**-32))
        else:
            if place == 0:
                high = digit << wp.uint64(32)
            elif place == 1:
                high = high | digit
            elif place == 2:
                low = digit << wp.uint64(32)
            elif place == 3:
                low = low | digit
            elif digit != wp.uint64(0):
                low = low | wp.uint64(1)
            place += 1
    result = rounded_bits(high, low, unit)
    if negative:
        result = -result
    return result


@wp.func
def rounded_sum(window: wp.array2d(dtype=wp.int64), wide: wp.array2d(dtype=wp.int64), index: int) -> wp.float64:
    """The sum at `index`, of whatever size, rounded once to the nearest float64."""
    most = wp.static(wp.int64(_WINDOW_MOST))
    if wide.shape[0] > 0 or wp.abs(window[wp.static(WINDOW_DIGITS - 1), index]) >= most:
        return rounded_wide(window, wide, index)
    return rounded_window(window, index)
