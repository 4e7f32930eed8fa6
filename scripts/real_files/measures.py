"""How far two pictures are apart beside the noise of both, how noisy an engine is, and medians with their intervals.

A picture is rendered twice, with two seeds: how far these two are apart shows the noise of their mean.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import asdict, dataclass

import numpy as np

from raybatch_addon.core.convergence.errors import RELMSE_MOST
from raybatch_addon.core.errors import RayBatchError

BLOCK = 4  # pixels of the edge of a block: pictures are compared by means of blocks, which have less noise
# Two pictures are the same where relMSE is at most SAME_RELMSE + SAME_NOISE x the relMSE that noise alone makes, and
# their means differ by less than SAME_BIAS beyond SIGMAS standard errors
SAME_RELMSE, SAME_NOISE, SAME_BIAS, SIGMAS = 0.01, 1.6, 0.02, 2.0
DARK = 1e-4  # added to squares, so that what is darker than 1 % of white counts as black
LIT = 0.01  # of the mean: a darker block shows nothing of brightness
RESAMPLES = 10_000
INTERVAL = (2.5, 97.5)  # percentiles


@dataclass(frozen=True)
class Pair:
    """Two linear pictures of one thing with different seeds, float64 [height, width, 3]."""

    first: np.ndarray
    second: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """The mean of both."""
        return (self.first + self.second) / 2

    @property
    def variance(self) -> np.ndarray:
        """The variance of `mean` in each pixel, estimated from the two: a quarter of their squared difference."""
        return np.square(self.first - self.second) / 4

    def in_blocks(self) -> Pair:
        """The means of blocks."""
        return Pair(blocks(self.first), blocks(self.second))

    @classmethod
    def sum(cls, pairs: list[Pair]) -> Pair:
        """The sums of first and of second pictures."""
        none = np.zeros(())
        return cls(sum((pair.first for pair in pairs), none), sum((pair.second for pair in pairs), none))


@dataclass(frozen=True)
class Agreement:
    """How a picture differs from the one it is held against."""

    relmse: float  # of blocks
    noise: float  # the part of it that the noise of both makes
    ratio: float  # mean of the picture over that of the other; NaN where that one is black
    ratio_error: float  # standard error of `ratio`
    typical: float  # median of the same ratio of blocks, which rare lights do not move; noise that is skewed does
    share_off: float  # share of blocks that differ by more than 10 %

    @property
    def relmse_most(self) -> float:
        """The largest relMSE at which the pictures count as the same."""
        return SAME_RELMSE + SAME_NOISE * self.noise

    @property
    def bias(self) -> float:
        """How much the means differ, beyond what noise explains: 0.02 is 2 %."""
        return 0.0 if math.isnan(self.ratio) else max(0.0, abs(self.ratio - 1) - SIGMAS * self.ratio_error)

    @property
    def same(self) -> bool:
        """Whether both show the same picture, as far as their noise lets it be seen."""
        return self.relmse <= self.relmse_most and self.bias < SAME_BIAS

    def data(self) -> dict[str, float | None]:
        """Each figure with six digits, as JSON holds it."""
        return {name: short(value) for name, value in asdict(self).items()}

    @classmethod
    def of_data(cls, data: dict[str, float | None]) -> Agreement:
        """The inverse of `data`."""
        return cls(**{name: math.nan if value is None else value for name, value in data.items()})


def short(value: float | None) -> float | None:
    """`value` with six digits; None for what is not finite."""
    return float(f"{value:.6g}") if value is not None and math.isfinite(value) else None


def blocks(picture: np.ndarray) -> np.ndarray:
    """Means of blocks of BLOCK x BLOCK pixels; rows and columns that fill no block are left out."""
    rows, columns = (max(1, size // BLOCK) for size in picture.shape[:2])
    down, across = min(BLOCK, picture.shape[0]), min(BLOCK, picture.shape[1])
    cut = picture[: rows * down, : columns * across]
    return cut.reshape(rows, down, columns, across, -1).mean((1, 3))


def relative_to(picture: np.ndarray) -> np.ndarray:
    """What squared errors are divided by: the picture's square, and a little that keeps dark pixels from counting for
    all others.
    """
    return np.square(picture) + 0.01 * float(np.median(picture)) ** 2 + DARK


def agreement(picture: Pair, other: Pair) -> Agreement:
    """How `picture` differs from `other`; raises `RayBatchError` where their sizes differ."""
    if picture.mean.shape != other.mean.shape:
        sizes = [f"{each.mean.shape[1]} x {each.mean.shape[0]}" for each in (picture, other)]
        raise RayBatchError(f"one engine wrote {sizes[0]} pixels and the other {sizes[1]}: they cannot be compared")
    ours, theirs = picture.in_blocks(), other.in_blocks()
    scale = relative_to(theirs.mean)
    apart = np.minimum(np.square(ours.mean - theirs.mean) / scale, RELMSE_MOST)
    noise = np.minimum((ours.variance + theirs.variance) / scale, RELMSE_MOST)
    bright_ours, bright_theirs = (np.maximum(each.mean.mean(-1), 0.0) for each in (ours, theirs))
    least = max(LIT * max(bright_ours.mean(), bright_theirs.mean()), math.sqrt(DARK) * 0.01)
    lit = np.maximum(bright_ours, bright_theirs) > least
    steps = np.log2((bright_ours[lit] + least) / (bright_theirs[lit] + least))
    ratio, error = _ratio(picture, other)
    return Agreement(
        relmse=float(apart.mean()),
        noise=float(noise.mean()),
        ratio=ratio,
        ratio_error=error,
        typical=float(2 ** np.median(steps)) if steps.size else math.nan,
        share_off=float((np.abs(steps) > math.log2(1.1)).sum() / lit.size),
    )


def _ratio(picture: Pair, other: Pair) -> tuple[float, float]:
    """Mean over mean, and its standard error, from pixels that are independent."""
    ours, theirs = float(picture.mean.mean()), float(other.mean.mean())
    if not theirs > 0:
        return math.nan, math.nan
    squares = []
    for each in (picture, other):
        apart = (each.first - each.second).mean(-1)
        squares.append(float(np.square(apart).sum()) / 4 / apart.size**2)
    ratio = ours / theirs
    return ratio, math.sqrt(squares[0] + squares[1] * ratio**2) / theirs


def noise_of(pair: Pair, shown: np.ndarray) -> float:
    """The relMSE of one picture of `pair`: half of that of the two against each other, cut at RELMSE_MOST a pixel.

    `shown` is the picture that errors are relative to: the same for engines that are compared.
    """
    return float(np.minimum(np.square(pair.first - pair.second) / 2 / relative_to(shown), RELMSE_MOST).mean())


def equal_error(ours: tuple[float, float], theirs: tuple[float, float]) -> float | None:
    """How many times as long an engine takes as another one to come to the same error, from the (seconds, noise) of
    both: noise falls as one over the samples, so that their product stays. None where a product is 0.
    """
    one, other = ours[0] * ours[1], theirs[0] * theirs[1]
    return one / other if one > 0 and other > 0 else None


@dataclass(frozen=True)
class Spread:
    """The median of values of many files, where it may lie, and the largest value."""

    median: float
    low: float  # the 95 % interval of the median, by resampling files
    high: float
    worst: float
    worst_of: str  # the file with the largest value
    count: int

    @classmethod
    def of(cls, values: dict[str, float]) -> Spread | None:
        """The spread of `values` by file; None where there are none."""
        if not values:
            return None
        numbers = np.array(list(values.values()), float)
        drawn = np.random.default_rng(0).integers(0, len(numbers), (RESAMPLES, len(numbers)))
        low, high = np.percentile(np.median(numbers[drawn], axis=1), INTERVAL)
        worst_of = max(values, key=values.__getitem__)
        return cls(
            statistics.median(numbers.tolist()), float(low), float(high), values[worst_of], worst_of, len(numbers)
        )

    def data(self) -> dict[str, float | str | None]:
        """The values as JSON holds them."""
        return {name: short(value) if isinstance(value, float) else value for name, value in asdict(self).items()}
