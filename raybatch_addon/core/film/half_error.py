"""The error of a film, told by how far two halves of its samples differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# What is added to a squared value, so that dark pixels do not decide alone (Rousselle et al. 2011); as `RELMSE_OFFSET` of `report`
RELATIVE_FLOOR = 0.01
_ROWS = 64  # looked at together, so that they stay in a cache


@dataclass(frozen=True)
class HalfError:
    """The estimated error of a picture."""

    relmse: float  # mean over pixels and channels of the squared error over (squared true value + 0.01)
    rmse: float  # root of the mean squared error


def half_error(first: np.ndarray, second: np.ndarray, samples: tuple[int, int]) -> HalfError:
    """The error of the film of both halves.

    With n and m independent samples of variance v the halves' means A and B differ by v (1/n + 1/m) in the mean of squares, and the mean of
    all n + m samples has the variance v / (n + m). So (A - B)^2 n m / (n + m)^2 estimates its squared error without bias; for halves of
    one size that is (A - B)^2 / 4, and holds for any unbiased halves with scrambles of their own, low-discrepancy points too.

    The square of the true value, which relMSE divides by, is told by A B: halves are independent, so its mean is that square. The square of
    the film's own value has the film's noise in it: a pixel that alone found a rare light would never count as more than 1 off.

    Args:
        first, second: pictures of either half, linear float32, shape [height, width, 3].
        samples: of every pixel, in either half; at least one each.
    """
    n, m = samples
    weight = n * m / (n + m) ** 2
    squared = np.zeros(first.shape[:1])  # by row, so that the sum does not depend on how rows are taken together
    relative = np.zeros(first.shape[:1])
    for row in range(0, len(first), _ROWS):
        part = slice(row, row + _ROWS)
        a, b = first[part].astype(np.float64), second[part].astype(np.float64)
        error = weight * (a - b) ** 2
        squared[part] = error.sum((1, 2))
        relative[part] = (error / (np.maximum(a * b, 0.0) + RELATIVE_FLOOR)).sum((1, 2))
    return HalfError(float(relative.sum() / first.size), float(np.sqrt(squared.sum() / first.size)))
