"""The watertight triangle test.

Woop, Benthin and Wald 2013, "Watertight Ray/Triangle Intersection": the corners are moved to the ray's origin and
sheared so that the ray runs along an axis z; in the plane across it the signs of three edge functions tell whether the
ray passes through. Two triangles that share an edge see the same sheared corners, and the sign of each edge function
is exact: it is a difference of two products by Kahan's scheme with fused multiply-adds (relative error at most 2u;
Jeannerod, Louvet and Muller 2013), and where it is so small that a product may leave the normal numbers all three are
computed again in float64, where products of float32 are exact. So no ray slips between two triangles.

    Sx = dx / dz, Sy = dy / dz, Sz = 1 / dz     z: the axis of the largest |d|, the first of equals; x, y follow in cycle
    a' = a - o; ax = fma(-Sx, az', ax'), ay = fma(-Sy, az', ay')                likewise b, c
    U = cx by - cy bx, V = ax cy - ay cx, W = bx ay - by ax
    hit when all are >= 0 or all are <= 0, and U + V + W is not 0
    r = 1 / (U + V + W); weights U r, V r, W r of the corners a, b, c
    t = fma(W r, cz', fma(V r, bz', (U r) az')) Sz

The result is a function of ray and triangle alone. `margin.py` bounds its error. On CUDA it is the same but for rounding: reciprocals
are approximate, and the order of x and y differs, which mirrors the triangle.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

EDGE_TINY = 2.0**-80
"""Edge functions up to this size are computed again in float64."""

TRIANGLE_TEXT = """
    // Scalar text for either device: lambdas `shear_ray` and `meet_triangle`, and their struct `ShearedRay`.
    //
    // Coordinates (x, y, z) in the ray's own axes, the last of which is `axis` 0..2. On a CPU the others follow it in cycle. On CUDA it
    // changes places with z, for which there is less to select; that may mirror a triangle, which is met from both sides anyway.
    auto along = [](int axis, float x, float y, float z) -> float { return axis == 0 ? x : axis == 1 ? y : z; };
    #if defined(__CUDA_ARCH__)
    auto across = [](int axis, float x, float y, float z) -> float { return axis == 0 ? z : x; };
    auto across_too = [](int axis, float x, float y, float z) -> float { return axis == 1 ? z : y; };
    #else
    auto across = [](int axis, float x, float y, float z) -> float { return axis == 0 ? y : axis == 1 ? z : x; };
    auto across_too = [](int axis, float x, float y, float z) -> float { return axis == 0 ? z : axis == 1 ? x : y; };
    #endif
    struct ShearedRay {
        float ox, oy, oz;  // origin
        float sx, sy, sz;  // dx / dz, dy / dz, 1 / dz in the ray's own axes
        int z;             // axis 0..2 of the direction's largest component
    };
    // Constants of the ray (o, d). d is not 0, of any length.
    auto shear_ray = [&](float ox, float oy, float oz, float dx, float dy, float dz) -> ShearedRay {
        ShearedRay r;
        const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
        r.ox = ox; r.oy = oy; r.oz = oz;
        r.z = ay > ax ? 1 : 0;
        if (az > (ay > ax ? ay : ax)) r.z = 2;
        const float d = along(r.z, dx, dy, dz);
        r.sx = across(r.z, dx, dy, dz) / d;
        r.sy = across_too(r.z, dx, dy, dz) / d;
        r.sz = 1.0f / d;
        return r;
    };
    // Whether the ray's line meets the triangle (a, b, c) at a t > 0. If so t, and the weights v of b and w of c.
    auto meet_triangle = [&](const ShearedRay& r, float ax, float ay, float az, float bx, float by, float bz,
                             float cx, float cy, float cz, float& t, float& v, float& w) -> bool {
    #if defined(__CUDA_ARCH__)
        auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
        auto lesser = [](float a, float b) -> float { return fminf(a, b); };
        auto bits = [](float a) -> int { return __float_as_int(a); };
        // an ulp off at most, for which the margin has room
        auto reciprocal = [](float a) -> float { float q; asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(q) : "f"(a)); return q; };
        auto quotient = [](double a, double b, double reciprocal_b) -> float { return (float)(a * reciprocal_b); };
    #else
        auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
        auto lesser = [](float a, float b) -> float { return a < b ? a : b; };
        auto bits = [](float a) -> int { int i; __builtin_memcpy(&i, &a, 4); return i; };
        auto reciprocal = [](float a) -> float { return 1.0f / a; };
        auto quotient = [](double a, double b, double reciprocal_b) -> float { return (float)(a / b); };
    #endif
        // corner (px, py, pz) with the origin at 0, in the ray's own axes, and sheared
        auto shear = [&](float& px, float& py, float& pz) {
            const float x = px - r.ox, y = py - r.oy, z = pz - r.oz;
            pz = along(r.z, x, y, z);
            px = fused(-r.sx, pz, across(r.z, x, y, z));
            py = fused(-r.sy, pz, across_too(r.z, x, y, z));
        };
        // a b - c d, the sign exact (Kahan)
        auto difference = [&](float a, float b, float c, float d) -> float {
            const float product = c * d;
            const float error = fused(-c, d, product);
            return fused(a, b, -product) + error;
        };
        shear(ax, ay, az); shear(bx, by, bz); shear(cx, cy, cz);
        float u = difference(cx, by, cy, bx);
        v = difference(ax, cy, ay, cx);
        w = difference(bx, ay, by, ax);
        // Where signs differ the sum counts as infinite: the weights are 0, and t is not above 0. (The highest bit is the sign.)
        if (lesser(lesser(fabsf(u), fabsf(v)), fabsf(w)) > EDGE_TINY) {
            const float q = reciprocal(((bits(u) ^ bits(v)) | (bits(u) ^ bits(w))) < 0 ? INFINITY : u + v + w);
            u *= q; v *= q; w *= q;
        } else {
            // on or near the line of an edge, or a triangle that is tiny or seen edge-on (then all are 0, and t is no number)
            const double du = (double)cx * by - (double)cy * bx;
            const double dv = (double)ax * cy - (double)ay * cx;
            const double dw = (double)bx * ay - (double)by * ax;
            const bool differ = (du < 0.0 || dv < 0.0 || dw < 0.0) && (du > 0.0 || dv > 0.0 || dw > 0.0);
            const double sum = differ ? (double)INFINITY : du + dv + dw, q = 1.0 / sum;
            u = quotient(du, sum, q); v = quotient(dv, sum, q); w = quotient(dw, sum, q);
        }
        t = fused(w, cz, fused(v, bz, u * az)) * r.sz;
        return t > 0.0f;
    };
""".replace("EDGE_TINY", f"{EDGE_TINY.hex()}f")


def fused_multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a b + c of float32, rounded once to float32, as processors with FMA do.

    The product is exact in float64. The sum is rounded to odd there, so that rounding it to float32 is as if it were exact
    (Boldo and Melquiond 2008).
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
    """The test in NumPy, equal to the native texts to the bit: whether each triangle is met at a t > 0, t, and the weights of b and c.

    One ray (shape [3]) against triangles, or rays against one triangle each: all float32, shape [3] or [n, 3].
    """
    with np.errstate(all="ignore"):
        o, d, a, b, c = np.broadcast_arrays(*(np.atleast_2d(np.asarray(x, np.float32)) for x in (origin, direction, a, b, c)))
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
            edges = np.stack([wide[4] * wide[3] - wide[5] * wide[2], wide[0] * wide[5] - wide[1] * wide[4], wide[2] * wide[1] - wide[3] * wide[0]])
            total = edges[0] + edges[1] + edges[2]
            hit[unsure] = ~((edges < 0).any(0) & (edges > 0).any(0)) & (total != 0)
            weights[:, unsure] = (edges / total).astype(np.float32)
        t = fused_multiply_add(weights[2], cz, fused_multiply_add(weights[1], bz, weights[0] * az)) * inverse
        return hit & (t > 0), t, weights[1], weights[2]


def intersect_exact(origin: np.ndarray, direction: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[Fraction, tuple[Fraction, ...]] | None:
    """Distance and weights of a, b, c where the line of one ray meets the plane of one triangle, exactly; None if it is parallel.

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
