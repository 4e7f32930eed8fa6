"""Buckets at random."""

from __future__ import annotations

import numpy as np

from ..policy import random_key


class Drawn:
    """Any bucket that is not empty, by random numbers that repeat: RANDOM of `policy.py`."""

    def __init__(self, seed: int):
        """`seed`: of the render."""
        self._seed, self._step = seed, 0

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`."""
        filled = np.flatnonzero(loads)
        keys = [random_key(self._seed, self._step, bucket) for bucket in filled.tolist()]
        self._step += 1
        return filled[[int(np.argmax(keys))]]
