"""What a policy is that the host asks."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Assignment(Protocol):
    """Chooses step by step."""

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """Buckets that are served next, numbers that rise, at least one; `loads` [buckets] are the rays that wait in
        each, of which some do.
        """
