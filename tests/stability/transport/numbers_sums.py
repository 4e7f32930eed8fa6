"""Numbers at their ends: sums of samples of any size, and the indices of many paths."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.film.sums import WIDE_DIGITS, WINDOW_DIGITS, add_wide, add_window, rounded_sums
from raybatch_addon.core.wavefront.stages.generate import pixel_sample
from raybatch_addon.core.wavefront.stages.work import TileWork
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case


@wp.kernel(**KERNEL_OPTIONS)
def _add_kernel(values: wp.array(dtype=float), window: wp.array2d(dtype=wp.int64), wide: wp.array2d(dtype=wp.int64)):
    i = wp.tid()
    if not add_window(window, 0, values[i]):
        add_wide(wide, 0, values[i])


def _summed(
    bench: Bench, values: np.ndarray, window: np.ndarray | None = None, wide: np.ndarray | None = None
) -> float:
    """The sum of float32 `values` by the film's digits, starting with the given ones, rounded once."""
    device = bench.wp_device
    digits = [
        wp.array(np.zeros((count, 1), np.int64) if first is None else first, dtype=wp.int64, device=device)
        for first, count in ((window, WINDOW_DIGITS), (wide, WIDE_DIGITS))
    ]
    wp.launch(_add_kernel, len(values), [wp.array(values, dtype=float, device=device), *digits], device=device)
    return float(rounded_sums(*(each.numpy() for each in digits))[0])


@case(
    "sums of all of float32",
    "numbers",
    "Sums of 200,000 numbers of any exponent of float32 and either sign, of which most cancel, against whole numbers "
    "of any length.",
    "fixed-point digits are exact whatever the order, and the sum is rounded once to float64: no bit may differ",
    traces=False,
    quick=True,
)
def any_sums(bench: Bench) -> Outcome:
    sweep = Sweep()
    for seed in range(4):
        generator = np.random.default_rng(seed)
        bits = generator.integers(0, 2**32, 100_000, dtype=np.uint64).astype(np.uint32)
        values = bits.view(np.float32)
        values = values[np.isfinite(values)]
        values = np.concatenate([values, -values[: len(values) - seed * 7], np.array([1e-45, 3e38, 1.0], np.float32)])
        generator.shuffle(values)
        exact = float(sum(int(value * 2.0**149) for value in values.astype(np.float64).tolist()) / (1 << 149))
        sweep.add(_summed(bench, values), exact, 0, f"seed {seed}")
    return sweep.outcome()


@case(
    "sums of 2^31 samples",
    "numbers",
    "Digits as they are after 2^31 - 1 of the largest samples of the window, and of float32: one more of either sign "
    "does not overflow.",
    "a digit counts less than 2^32 a sample, so that 2^31 of them are below 2^63: the sums are exact",
    traces=False,
    quick=True,
)
def largest_sums(bench: Bench) -> Outcome:
    sweep, many, full = Sweep(), 2**31 - 1, 2**32 - 1
    largest = np.float32(np.nextafter(np.float32(2.0**32), np.float32(0)))  # 2^32 - 2^8: digits 2^32 - 256, 0, 0, 0
    for sign in (1, -1):
        window = np.full((WINDOW_DIGITS, 1), sign * many * full, np.int64)
        exact = Fraction(
            sign * many * full * sum(2 ** (32 * k) for k in range(WINDOW_DIGITS)), 2**96
        ) + sign * Fraction(float(largest))
        sweep.add(_summed(bench, np.array([sign * largest], np.float32), window=window), float(exact), 0, "window")
        most = np.float32(np.finfo(np.float32).max)
        wide = np.full((WIDE_DIGITS, 1), sign * many * full, np.int64)
        exact = Fraction(sign * many * full * sum(2 ** (32 * k) for k in range(WIDE_DIGITS)), 2**160) + sign * Fraction(
            float(most)
        )
        sweep.add(_summed(bench, np.array([sign * most], np.float32), wide=wide), float(exact), 0, "wide digits")
    return sweep.outcome()


@wp.kernel(**KERNEL_OPTIONS)
def _place_kernel(work: TileWork, numbers: wp.array(dtype=wp.uint32), found: wp.array2d(dtype=wp.int64)):
    i = wp.tid()
    pixel = pixel_sample(work, numbers[i])
    found[i, 0] = wp.int64(pixel.x)
    found[i, 1] = wp.int64(pixel.y)
    found[i, 2] = wp.int64(pixel.sample)


@case(
    "paths numbered beyond 2^32",
    "numbers",
    """Numbers of paths up to 2^44 in tiles of up to 16384 x 1 pixels with 2^32 samples, frame first and pixel first:
    pixel and sample, against whole numbers of any length. Wrong ones are counted.""",
    "whole numbers: none may be wrong",
    traces=False,
    quick=True,
)
def many_paths(bench: Bench) -> Outcome:
    sweep, generator, device = Sweep(), np.random.default_rng(1), bench.wp_device
    for width, height, samples in ((16384, 1, 2**28), (1, 1, 2**32), (3, 1, 2**32), (1, 4096, 2**32), (4096, 1, 2**20)):
        for pixel_first in (0, 1):
            for base in (0, 2**31, 2**32 - 5, 2**33 + 1, width * height * samples - 2**14):
                if not 0 <= base <= width * height * samples - 2**14:
                    continue
                numbers = np.unique(np.concatenate([np.arange(16), generator.integers(0, 2**14, 500)])).astype(
                    np.uint32
                )
                work = TileWork()
                work.x, work.y, work.width, work.height, work.frame_width = 0, 0, width, height, width
                work.sample_first, work.sample_count, work.pixel_first, work.item_base = 0, samples, pixel_first, base
                found = wp.zeros((len(numbers), 3), dtype=wp.int64, device=device)
                wp.launch(
                    _place_kernel,
                    len(numbers),
                    [work, wp.array(numbers, dtype=wp.uint32, device=device), found],
                    device=device,
                )
                wrong = 0
                for number, (x, y, sample) in zip(numbers.tolist(), found.numpy().tolist(), strict=True):
                    item = base + number
                    # a row or a column: pixels are walked one after another
                    pixel, index = (
                        (item // samples, item % samples)
                        if pixel_first
                        else (item % (width * height), item // (width * height))
                    )
                    wrong += (x + y, sample) != (pixel, index)
                sweep.add(
                    wrong, 0, 0, f"{width} x {height} pixels, {samples} samples, from {base}, pixel first {pixel_first}"
                )
    return sweep.outcome()
