"""Gradient noise in float64 over Python's integers."""

import itertools
import math

from tests.twins.hash_reference import WORD, jenkins

SCALES = (0.25, 0.6616, 0.982, 0.8344)  # by dimensions


def slope(bits, at):
    """What a lattice point whose hash is `bits` gives at `at` from it."""
    if len(at) == 1:
        return (1 + bits % 8) * (-1 if bits & 8 else 1) * at[0]
    if len(at) == 2:
        u, v = at if bits & 4 == 0 else at[::-1]
        chosen = [u, 2 * v]
    elif len(at) == 3:
        h = bits & 15
        x, y, z = at
        chosen = [x if h < 8 else y, y if h < 4 else x if h in (12, 14) else z]
    else:
        h = bits & 31
        x, y, z, w = at
        chosen = [x if h < 24 else y, y if h < 16 else z, z if h < 8 else w]
    return sum(-value if bits >> k & 1 else value for k, value in enumerate(chosen))


def signed_noise(point):
    """Noise at one point, a sequence of one to four numbers."""
    cell = [math.floor(x) for x in point]
    total = 0.0
    for corner in itertools.product((0, 1), repeat=len(point)):
        at = [x - i - c for x, i, c in zip(point, cell, corner)]
        fades = [t**3 * (t * (6 * t - 15) + 10) for t in (x - i for x, i in zip(point, cell))]
        weight = math.prod(f if c else 1 - f for f, c in zip(fades, corner))
        total += weight * slope(jenkins([(i + c) & WORD for i, c in zip(cell, corner)]), at)
    return SCALES[len(point) - 1] * total
