"""Films that should be equal bit for bit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def differing_pixels(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels of which any bit differs; `a` and `b` are float32, shape [height, width, channels]."""
    a, b = (np.ascontiguousarray(each, np.float32).view(np.uint32) for each in (a, b))
    return int((a != b).any(-1).sum())


def differing_passes(mine: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> list[str]:
    """Names of the passes [height, width, channels] of which any bit differs, or that one of the two does not have."""
    return [
        name
        for name in dict.fromkeys([*mine, *other])
        if name not in mine or name not in other or differing_pixels(mine[name], other[name])
    ]
