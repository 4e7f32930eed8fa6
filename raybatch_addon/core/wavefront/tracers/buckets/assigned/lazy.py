"""Processors that stay with their bucket until it is empty."""

from __future__ import annotations

import numpy as np


class Lazy:
    """Each processor serves a bucket as long as rays wait there, and is then given the fullest that no other one has
    (Aila and Karras 2010, "Architecture considerations for tracing incoherent rays", the lazy scheduler).
    """

    def __init__(self, processors: int):
        """`processors`: 1 or more."""
        self._processors = processors
        self._bound = np.zeros(0, np.int64)

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`: at most as many as there are processors."""
        kept = self._bound[loads[self._bound] > 0]
        others = np.flatnonzero(loads)
        others = np.setdiff1d(others, kept, assume_unique=True)
        others = others[np.argsort(-loads[others], kind="stable")][: self._processors - len(kept)]
        self._bound = np.sort(np.concatenate([kept, others]))
        return self._bound
