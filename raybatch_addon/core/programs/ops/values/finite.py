"""Guards against numbers that are not finite."""

import warp as wp

from ....float32 import LARGEST


@wp.func
def finite_or_zero(x: float) -> float:
    """`x`, or 0 for infinities and NaN."""
    return wp.where(wp.abs(x) <= LARGEST, x, 0.0)


@wp.func
def finite_vector_or_zero(v: wp.vec3) -> wp.vec3:
    """`v` with 0 in place of infinities and NaN."""
    return wp.vec3(finite_or_zero(v[0]), finite_or_zero(v[1]), finite_or_zero(v[2]))
