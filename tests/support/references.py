"""References from several pictures."""

from collections.abc import Sequence

import numpy as np

from raybatch_addon.core.convergence.reference import Reference


def reference_of_runs(pictures: Sequence[np.ndarray], name: str, samples: int) -> Reference:
    """The mean of at least two independent pictures with `samples` samples together, and its variance from their
    spread.
    """
    stack = np.asarray(pictures, np.float64)
    return Reference(stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack), name, samples)
