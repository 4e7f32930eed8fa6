"""Numbers of float32 that bounds of errors, random numbers and angles are made of."""

import math

import numpy as np
import warp as wp

# Unit roundoff. n operations are wrong by at most n u / (1 - n u), relatively (Higham 2002, section 3.1).
UNIT_ROUNDOFF = 2.0**-24
ONE_BELOW = wp.constant(1.0 - UNIT_ROUNDOFF)  # the largest number below 1
PI, TWO_PI, HALF_PI = (wp.constant(factor * math.pi) for factor in (1.0, 2.0, 0.5))
LARGEST = wp.constant(float(np.finfo(np.float32).max))


def roundoff(count: int) -> float:
    """The relative error of `count` operations, at most."""
    return count * UNIT_ROUNDOFF / (1 - count * UNIT_ROUNDOFF)
