"""The hash by which Cycles draws random numbers of things."""

from __future__ import annotations

import numpy as np


def lookup3(keys: np.ndarray, words: int = 1) -> np.ndarray:
    """Jenkins' lookup3 (2006) of one word each, uint32; with two `words` the second is 0."""
    with np.errstate(over="ignore"):
        start = np.uint32((0xDEADBEEF + (words << 2) + 13) & 0xFFFFFFFF)
        a, b, c = keys + start, np.full_like(keys, start), np.full_like(keys, start)
        for target, other, by in ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)):
            state = [a, b, c]
            source = state[other]
            state[target] = (state[target] ^ source) - ((source << np.uint32(by)) | (source >> np.uint32(32 - by)))
            a, b, c = state
    return c
