"""How far a picture is from another: RMSE and relMSE, against a reference or estimated from two halves of a render.

All pictures are linear RGB, shape [height, width, 3]; whatever their type, errors are computed in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import RayBatchError

# Added to the square of the reference in relMSE, so that dark pixels do not count for all others
# (Rousselle, Knaus and Zwicker 2011, "Adaptive sampling and reconstruction using greedy error minimization")
RELMSE_OFFSET = 0.01
# Most that a channel of a pixel counts for in `relmse_cut`
RELMSE_MOST = 10.0


@dataclass(frozen=True, kw_only=True)
class ErrorPoint:
    """How far a render had come at one of its snapshots. Errors of a reference are in them: nothing is subtracted."""

    seconds: float  # of rendering alone
    seconds_total: float  # with build and compile
    samples: float  # of every pixel, or where they differ in the mean
    rays: dict[str, int]  # by kind
    rmse: float
    relmse: float
    relmse_cut: float | None = None  # the same, no pixel counting for more than `RELMSE_MOST`; None: not known
    flip: float | None = None  # mean FLIP, where somebody gave a function for it
    invalid_samples: int = 0
    # standard error of `rmse`, from how the squared error varies from pixel to pixel; None: one pixel
    rmse_spread: float | None = None
    # What the reference's own noise adds (`noise_floor`), 0 for a closed form; None: not known
    floor_rmse: float | None = None
    floor_relmse: float | None = None
    samples_most: int = 0  # of the pixels that have most; 0: `samples`
    from_halves: bool = False  # estimated from two halves of the render, without a reference: a bias is not in it

    @property
    def relmse_most(self) -> float:
        """relMSE that no firefly rules, as far as it is known."""
        return self.relmse if self.relmse_cut is None else self.relmse_cut

    def data(self) -> dict[str, Any]:
        """For JSON; None is what is not known."""
        return {
            "seconds": self.seconds,
            "samples": self.samples,
            "rmse": known(self.rmse),
            "relmse": known(self.relmse),
            "relmse_cut": known(self.relmse_cut),
            "flip": known(self.flip),
            "seconds_total": self.seconds_total,
            "rays": self.rays or None,
            "invalid_samples": self.invalid_samples,
        }


def known(value: float | None) -> float | None:
    """`value`; None where it is not finite, which JSON cannot say."""
    return value if value is not None and math.isfinite(value) else None


def squared_error(picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(picture - reference)^2, float64; raises `RayBatchError` where the two differ in shape."""
    x, r = _alike(picture, reference)
    return np.square(x - r)


def squared_error_of_halves(a: np.ndarray, b: np.ndarray, samples: int | np.ndarray = 0) -> np.ndarray:
    """(a - b)^2 / 4, float64: in each pixel an unbiased estimate of the squared error of (a + b) / 2.

    `a` and `b` are independent, without bias, and have as many samples: then the mean of (a - b)^2 is twice the
    variance of one of them, and their mean has half of that variance. A bias that both have is not seen. Where both
    have an odd number of `samples` together, n and m, the factor is n m / (n + m)^2. Where pixels have different
    numbers `samples` has shape [height, width]; one with less than 2 samples has no error.
    """
    if isinstance(samples, np.ndarray):
        some = np.maximum(samples, 1).astype(np.float64)[..., None]
        return squared_error(a, b) * ((some // 2) * (some - some // 2) / some**2)
    weight = 0.25 if samples % 2 == 0 else (samples // 2) * (samples - samples // 2) / samples**2
    return squared_error(a, b) * weight


def relative_to(reference: np.ndarray) -> np.ndarray:
    """What relMSE divides squared errors by: reference^2 + 0.01, float64."""
    return np.square(np.asarray(reference, np.float64)) + RELMSE_OFFSET


def relative_to_halves(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The same without a reference, float64: a b + 0.01, for the mean of a b is the square of what two independent
    halves show.

    Not the square of their mean: that has their noise in it, so that a pixel in which one half alone found a rare light
    would never count as more than 1 off.
    """
    x, y = _alike(a, b)
    return np.maximum(x * y, 0.0) + RELMSE_OFFSET


def rmse(picture: np.ndarray, reference: np.ndarray) -> float:
    """Root of the mean of (picture - reference)^2 over pixels and channels."""
    return math.sqrt(squared_error(picture, reference).mean())


def relmse(picture: np.ndarray, reference: np.ndarray) -> float:
    """Mean of (picture - reference)^2 / (reference^2 + 0.01) over pixels and channels (Rousselle et al. 2011)."""
    return float((squared_error(picture, reference) / relative_to(reference)).mean())


def relmse_cut(error: np.ndarray, scale: np.ndarray) -> float:
    """The mean of `error` / `scale` in which no pixel counts for more than `RELMSE_MOST`: a picture with one firefly is
    a picture with one bad pixel. Both are float64 [height, width, 3], from `squared_error` and `relative_to` or their
    twins of halves.
    """
    return float(np.minimum(error / scale, RELMSE_MOST).mean())


def rmse_of_halves(a: np.ndarray, b: np.ndarray) -> float:
    """The RMSE of (a + b) / 2, estimated without a reference (see `squared_error_of_halves`)."""
    return math.sqrt(squared_error_of_halves(a, b).mean())


def relmse_of_halves(a: np.ndarray, b: np.ndarray) -> float:
    """The relMSE of (a + b) / 2, estimated without a reference (see `relative_to_halves`)."""
    return float((squared_error_of_halves(a, b) / relative_to_halves(a, b)).mean())


def _alike(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if a.shape != b.shape:
        raise RayBatchError(f"pictures of {_size(a)} and {_size(b)} cannot be compared; render both in the same size")
    if not a.size:
        raise RayBatchError("pictures without pixels cannot be compared")
    return a, b


def _size(picture: np.ndarray) -> str:
    if picture.ndim != 3:
        return f"shape {list(picture.shape)}"
    return f"{picture.shape[1]} x {picture.shape[0]} pixels of {picture.shape[2]} channels"
