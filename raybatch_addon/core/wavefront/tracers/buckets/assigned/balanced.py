"""Queues that are kept alike in length."""

from __future__ import annotations

import numpy as np


class Balanced:
    """All buckets are served in which more rays wait than a target, so that none grows long (Aila and Karras 2010,
    "Architecture considerations for tracing incoherent rays", the balanced scheduler).

    The thesis gives no target. Here it is the mean of those that are not empty: some bucket always has as many.
    """

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`."""
        waiting = np.count_nonzero(loads)
        # in integers, so that no rounding leaves all of them below their mean
        return np.flatnonzero((loads > 0) & (loads.astype(np.int64) * waiting >= loads.sum(dtype=np.int64)))
