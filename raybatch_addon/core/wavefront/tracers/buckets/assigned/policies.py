"""What a policy of several buckets is, and which there are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ..policy import Selection
from .balanced import Balanced
from .lazy import Lazy


class Assignment(Protocol):
    """Chooses step by step."""

    def choose(self, loads: np.ndarray) -> np.ndarray:
        """Buckets that are served next, numbers that rise, at least one; `loads` [buckets] are the rays that wait in
        each, of which some do.
        """


ASSIGNMENTS: dict[Selection, Callable[[int], Assignment]] = {Selection.LAZY: Lazy, Selection.BALANCED: Balanced}
"""Makers of policies for so many processors, by selection; the others serve one bucket in a step, or all."""
