"""Buckets in turn."""

from __future__ import annotations

import numpy as np


class InTurn:
    """The next bucket behind the last one that is not empty: NEXT of `policy.py`."""

    def __init__(self) -> None:
        """The first bucket is the first."""
        self._last = -1

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`."""
        filled = np.flatnonzero(loads)
        behind = (filled - self._last - 1) % len(loads)
        self._last = int(filled[behind.argmin()])
        return np.array([self._last])
