"""The noise around each pixel, and which pixels end their sampling by it.

Two halves of a pixel's samples, of means A and B, differ by twice the standard error of all of them in the root of the
mean square. The squared error of one pixel has a single degree of freedom, so that by chance it is often small; the
mean over a neighbourhood is not. A pixel's own samples have no part in that mean: where sampling ends by what the
samples themselves show, pixels stop while a rare bright path has not come yet and go on once it has, which makes
pictures dark (Kirk and Arvo 1991, "Unbiased sampling techniques for image synthesis"). Where pixels have random numbers
of their own, what the neighbours show says nothing of a pixel's own samples, and the mean of these keeps its
expectation. From the second look on something of them comes back, by way of the neighbours that went on because of
them; docs/studies/adaptive.md says how much. With `sample_sequence` BLUE_NOISE neighbours share points out among them,
so that what they show is not independent of a pixel's own samples.

The error is relative as an eye sees it: to the root of the brightness (Dammertz, Hanika, Keller and Lensch 2010, "A
hierarchical automatic stopping condition for Monte Carlo global illumination"), where a display still shows it, and to
the brightness itself beyond. The alpha of a transparent film counts by its own error, as a brightness of 1 would.
"""

from __future__ import annotations

import warp as wp

from ...device.kernel import KERNEL_OPTIONS

# Pixels whose noise decides for the one in their middle: (2 RADIUS + 1)^2 - 1
RADIUS = 3
# Sums of channels count for no more, so that those beyond float32 are no infinities
SUM_MAX = 3e38


@wp.struct
class NoisePart:
    """Pixels of a rectangle of the region, row by row, as the halves show them."""

    first: wp.array(dtype=wp.vec4)  # RGBA of half 0
    second: wp.array(dtype=wp.vec4)
    first_counts: wp.array(dtype=wp.int64)  # samples
    second_counts: wp.array(dtype=wp.int64)
    width: int
    corner: int  # where its bottom left pixel is among those of the region


@wp.func
def sample_noise(first: wp.vec4, second: wp.vec4, count: wp.int64) -> float:
    """The squared relative error that one sample of a pixel has, from the means of two halves of `count` samples.

    Between 0, where the halves show the same, and `count`, and for alpha up to a quarter of `count` more.
    """
    alpha = 0.5 * (first[3] - second[3])  # 0 unless the film is transparent
    alpha_noise = alpha * alpha * float(count)
    difference = wp.abs(first[0] - second[0]) + wp.abs(first[1] - second[1]) + wp.abs(first[2] - second[2])
    if difference == 0.0:
        return alpha_noise
    light = 0.5 * (first[0] + second[0] + first[1] + second[1] + first[2] + second[2])
    if light <= 0.0:
        return alpha_noise + float(count)
    # compared, for a minimum may lose what is no number
    if difference > wp.static(SUM_MAX):
        difference = wp.static(SUM_MAX)
    if light > wp.static(SUM_MAX):
        light = wp.static(SUM_MAX)
    ratio = 0.5 * difference / light
    if ratio > 1.0:  # with channels below 0
        ratio = 1.0
    # the error counts by the root of light below 1, and by the light itself beyond
    return alpha_noise + ratio * ratio * wp.min(light, 1.0) * float(count)


@wp.kernel(**KERNEL_OPTIONS)
def sample_noise_kernel(part: NoisePart, width: int, noise: wp.array(dtype=float)):
    """The noise of one sample of each pixel of `part`, in a region of `width` pixels."""
    i = wp.tid()
    row = i / part.width
    count = part.first_counts[i] + part.second_counts[i]
    noise[part.corner + row * width + i - row * part.width] = sample_noise(part.first[i], part.second[i], count)


@wp.kernel(**KERNEL_OPTIONS)
def row_sums_kernel(noise: wp.array(dtype=float), width: int, sums: wp.array(dtype=wp.vec2)):
    """Each pixel's sum over the row of its neighbourhood, with and without itself."""
    i = wp.tid()
    column = i % width
    left = float(0.0)
    right = float(0.0)
    for step in range(1, wp.static(RADIUS + 1)):
        if column >= step:
            left += noise[i - step]
        if column + step < width:
            right += noise[i + step]
    sums[i] = wp.vec2(left + right + noise[i], left + right)


@wp.kernel(**KERNEL_OPTIONS)
def stop_kernel(
    sums: wp.array(dtype=wp.vec2), width: int, height: int, samples: int, limit: float, stopped: wp.array(dtype=int)
):
    """End the sampling of pixels that have `samples` samples, and around them a mean squared error below `limit`:
    `stopped` is 0 for those that go on, else how many samples they have.
    """
    i = wp.tid()
    if stopped[i] != 0:
        return
    row = i / width
    column = i - row * width
    total = sums[i][1]
    rows = int(1)
    for step in range(1, wp.static(RADIUS + 1)):
        if row >= step:
            total += sums[i - step * width][0]
            rows += 1
        if row + step < height:
            total += sums[i + step * width][0]
            rows += 1
    columns = wp.min(column, wp.static(RADIUS)) + wp.min(width - 1 - column, wp.static(RADIUS)) + 1
    neighbours = rows * columns - 1
    # a pixel without neighbours goes on: nothing is known of it but what its own samples say
    if neighbours > 0 and total / float(neighbours) < limit * float(samples):
        stopped[i] = samples
