"""The bucket with the most rays."""

from __future__ import annotations

import numpy as np


class Fullest:
    """One bucket in a step, of equals the first: MOST_FULL of `policy.py`."""

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """See `Assignment.choose`."""
        return loads.argmax(keepdims=True)
