"""Buckets of one large treelet at a time."""

from __future__ import annotations

import numpy as np

from .interface import Assignment


class WithinLarge:
    """The buckets of a large treelet are served until no ray waits in any of them, and then those of the one in which
    most rays wait (the thesis, 6.3): so a large treelet stays in a cache, and treelets in it come and go in a smaller
    one. Which of its buckets are next, another policy says.
    """

    def __init__(self, policy: Assignment, large: np.ndarray):
        """`policy` chooses among buckets of which the large treelets are `large`, from 0 on; -1: in none."""
        self._policy, self._group, self._now = policy, large + 1, 0

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`."""
        within = np.where(self._group == self._now, loads, 0)
        if not within.any():
            self._now = int(np.bincount(self._group, loads).argmax())
            within = np.where(self._group == self._now, loads, 0)
        return self._policy.choose(within)
