"""The watertight triangle test in NumPy, to the bit of the native functions, and in exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from raybatch_addon.core.bvh.intersect import EDGE_TINY


def fused_multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a b + c of float32, rounded once to float32, as processors with FMA do.

    The product is exact in float64. The sum is rounded to odd there, so that rounding it to float32 is as if it were
    exact (Boldo and Melquiond 2008).
    """
    a, b, addend = (np.asarray(x).astype(np.float64) for x in (a, b, c))
    product = a * b
    total = product + addend
    part = total - product
    with np.errstate(invalid="ignore"):
        error = (product - (total - part)) + (addend - part)
    bits = np.asarray(total).view(np.int64)
    even = (error != 0) & (bits & 1 == 0) & np.isfinite(total)
    outwards = (error > 0) == (total > 0)
    with np.errstate(over="ignore"):
        return np.where(even, bits + np.where(outwards, 1, -1), bits).view(np.float64).astype(np.float32)


def intersect_float32(
    origin: np.ndarray, direction: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The test in NumPy, equal to the native functions to the bit: whether each triangle is met at a t > 0, t, and the
    weights of b and c.

    One ray (shape [3]) against triangles, or rays against one triangle each: all float32, shape [3] or [n, 3].
    """
    with np.errstate(all="ignore"):
        o, d, a, b, c = np.broadcast_arrays(
            *(np.atleast_2d(np.asarray(x, np.float32)) for x in (origin, direction, a, b, c))
        )
        z = np.argmax(np.abs(d), axis=1)
        axes = np.stack([(z + 1) % 3, (z + 2) % 3, z], 1)
        o, d = np.take_along_axis(o, axes, 1), np.take_along_axis(d, axes, 1)
        shear = d[:, :2] / d[:, 2:]
        inverse = np.float32(1) / d[:, 2]

        def sheared(corner):
            corner = np.take_along_axis(corner, axes, 1) - o
            height = corner[:, 2]
            return (*(fused_multiply_add(-shear[:, k], height, corner[:, k]) for k in (0, 1)), height)

        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = sheared(a), sheared(b), sheared(c)

        def difference(p, q, r, s):
            product = r * s
            return fused_multiply_add(p, q, -product) + fused_multiply_add(-r, s, product)

        u, v, w = difference(cx, by, cy, bx), difference(ax, cy, ay, cx), difference(bx, ay, by, ax)
        least, most, tiny = np.minimum(np.minimum(u, v), w), np.maximum(np.maximum(u, v), w), np.float32(EDGE_TINY)
        hit = (least > tiny) | (most < -tiny)
        unsure = ((least >= -tiny) | (most <= tiny)) & ~hit
        r = np.float32(1) / (u + v + w)
        weights = np.stack([u * r, v * r, w * r])
        if unsure.any():
            wide = [x[unsure].astype(np.float64) for x in (ax, ay, bx, by, cx, cy)]
            edges = np.stack(
                [
                    wide[4] * wide[3] - wide[5] * wide[2],
                    wide[0] * wide[5] - wide[1] * wide[4],
                    wide[2] * wide[1] - wide[3] * wide[0],
                ]
            )
            total = edges[0] + edges[1] + edges[2]
            hit[unsure] = ~((edges < 0).any(0) & (edges > 0).any(0)) & (total != 0)
            weights[:, unsure] = (edges / total).astype(np.float32)
        t = fused_multiply_add(weights[2], cz, fused_multiply_add(weights[1], bz, weights[0] * az)) * inverse
        return hit & (t > 0), t, weights[1], weights[2]


def intersect_exact(
    origin: np.ndarray, direction: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> tuple[Fraction, tuple[Fraction, ...]] | None:
    """Distance and weights of a, b, c where the line of one ray meets the plane of one triangle, exactly; None if it is
    parallel.

    The triangle is met where no weight is negative. Arguments of shape [3].
    """
    o, d, p, q, r = ([Fraction(float(x)) for x in vector] for vector in (origin, direction, a, b, c))

    def minus(x, y):
        return [i - j for i, j in zip(x, y)]

    def cross(x, y):
        return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]

    def dot(x, y):
        return sum(i * j for i, j in zip(x, y))

    p, q, r = minus(p, o), minus(q, o), minus(r, o)
    volumes = [dot(d, cross(r, q)), dot(d, cross(p, r)), dot(d, cross(q, p))]
    total = sum(volumes)
    if total == 0:
        return None
    weights = tuple(volume / total for volume in volumes)
    height = [sum(weight * corner[k] for weight, corner in zip(weights, (p, q, r))) for k in range(3)]
    return dot(height, d) / dot(d, d), weights
