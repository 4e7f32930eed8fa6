"""The error of a film while it is rendered, estimated from how far two halves of its samples differ."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .errors import relative_to_halves, squared_error, squared_error_of_halves

_ROWS = 64  # looked at together, so that they stay in a cache


@dataclass(frozen=True)
class HalfError:
    """The estimated error of a picture."""

    relmse: float  # mean over pixels and channels of the squared error over (squared true value + 0.01)
    rmse: float  # root of the mean squared error


def half_error(first: np.ndarray, second: np.ndarray, samples: int | np.ndarray) -> HalfError:
    """The error of the film of both halves.

    With n and m independent samples of variance v the halves' means A and B differ by v (1/n + 1/m) in the mean of
    squares, and the mean of all n + m samples has the variance v / (n + m). So (A - B)^2 n m / (n + m)^2 estimates its
    squared error without bias; for halves of one size that is (A - B)^2 / 4, and holds for any unbiased halves with
    scrambles of their own, low-discrepancy points too.

    Args:
        first, second: pictures of either half, linear float32, shape [height, width, 3].
        samples: of every pixel in both together, or of each, shape [height, width]; at least 2, and in one half as many
            as in the other, or one more. Of several numbers those below 2 leave their pixel out.
    """
    squared = np.zeros(first.shape[:1])  # by row, so that the sum does not depend on how rows are taken together
    relative = np.zeros(first.shape[:1])
    for row in range(0, len(first), _ROWS):
        part = slice(row, row + _ROWS)
        count = samples[part] if isinstance(samples, np.ndarray) else samples
        error = squared_error_of_halves(first[part], second[part], count)
        squared[part] = error.sum((1, 2))
        relative[part] = (error / relative_to_halves(first[part], second[part])).sum((1, 2))
    size = first.size
    if isinstance(samples, np.ndarray):  # the others have no error, see `squared_error_of_halves`
        size = max(np.count_nonzero(samples >= 2), 1) * first.shape[2]
    return HalfError(float(relative.sum() / size), math.sqrt(squared.sum() / size))


def filtered_half_error(
    first: np.ndarray, second: np.ndarray, filtered_first: np.ndarray, filtered_second: np.ndarray
) -> HalfError:
    """The error that the picture of either half has once it is filtered (denoised), its bias included.

    The halves A and B are independent and without bias, so (F(A) - B)^2 is in the mean the squared error of F(A) plus
    the variance of B. Both ways together have the variances of both, which (A - B)^2 shows: their mean less
    (A - B)^2 / 2 estimates the squared error of the filtered halves without bias, however many samples each has. That
    of all samples, filtered, is lower as a rule.

    All are linear float32, shape [height, width, 3]. An estimate below 0, where noise is all there is, counts as 0.
    """
    crossed = squared_error(filtered_first, second) + squared_error(filtered_second, first)
    error = 0.5 * (crossed - squared_error(first, second))
    relative = float((error / relative_to_halves(first, second)).mean())
    return HalfError(max(relative, 0.0), math.sqrt(max(float(error.mean()), 0.0)))
