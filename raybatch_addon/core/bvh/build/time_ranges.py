"""Ranges of time: things that move get a tree for each of some equal parts of the time while the shutter is open.

A box around all that a thing comes by is met by many rays that the thing is nowhere near at their time. Around what it
comes by in a part of the time it is smaller; a ray goes through the tree of the part that its own time is in, and knows
of no other. (Woop, Áfra and Benthin 2017, "STBVH: A spatial-temporal BVH for efficient multi-segment motion blur", have
both in one tree, as parts of things in space and time; docs/studies/trees-over-time.md compares.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

RANGES_MOST = 8
# Twice as many ranges must make a ray's expected steps less by so much, for the memory that they take
RANGE_GAIN_LEAST = 0.1


def bounds(index: int, count: int) -> tuple[float, float]:
    """First and last time of range `index` of `count`, which is a power of two."""
    return index / count, (index + 1) / count


def best_count(costs: Sequence[float]) -> int:
    """How many ranges to have, from the `costs` of a ray with 1, 2, 4, ... of them."""
    worth = [cost / (1 - RANGE_GAIN_LEAST) ** doubled for doubled, cost in enumerate(costs)]
    return 1 << int(np.argmin(worth))


def vertices_between(steps: np.ndarray, first: float, last: float) -> list[np.ndarray]:
    """Positions around which a box of any triangle holds it at all times from `first` to `last`, float32, each of shape
    [n, 3].

    `steps`: at evenly spaced times from 0 to 1, between which vertices move along lines, float32, shape [steps, n, 3].

    A traversal mixes two steps in float32 and keeps the mix within them (`native/traverse/motion.h`). So do these, in
    the same operations, each of which is rounded: a mix at a time in between is between them, to the last bit.
    """
    parts = len(steps) - 1
    found = [steps[i] for i in range(int(np.floor(first * parts)) + 1, int(np.ceil(last * parts)))]
    for at in (first * parts, last * parts):
        step = min(int(at), parts - 1)
        before, behind, share = steps[step], steps[step + 1], np.float32(at - step)
        if share in (0, 1):
            found.append(behind if share else before)
            continue
        with np.errstate(invalid="ignore", over="ignore"):  # of segments of curves some are no positions
            mixed = before + share * (behind - before)
        found.append(np.clip(mixed, np.minimum(before, behind), np.maximum(before, behind)))
    return found
