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

The result is a function of ray and triangle alone. `margin.py` bounds its error.
"""

from __future__ import annotations

EDGE_TINY = 2.0**-80
"""Edge functions up to this size are computed again in float64."""

TRIANGLE_TEXT = """
    // Scalar text for either device: a lambda `shear_ray`, a lambda `meet_triangle`, their struct `ShearedRay`.
    struct ShearedRay {
        float ox, oy, oz;  // origin
        float sx, sy, sz;  // dx / dz, dy / dz, 1 / dz in the permuted axes
        int z;             // axis 0..2 of the direction's largest component
    };
    // Constants of the ray (o, d). d is not 0, of any length.
    auto shear_ray = [](float ox, float oy, float oz, float dx, float dy, float dz) -> ShearedRay {
        ShearedRay r;
        const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
        r.ox = ox; r.oy = oy; r.oz = oz;
        r.z = ay > ax ? 1 : 0;
        if (az > (ay > ax ? ay : ax)) r.z = 2;
        const float d = r.z == 0 ? dx : r.z == 1 ? dy : dz;
        r.sx = (r.z == 0 ? dy : r.z == 1 ? dz : dx) / d;
        r.sy = (r.z == 0 ? dz : r.z == 1 ? dx : dy) / d;
        r.sz = 1.0f / d;
        return r;
    };
    // Whether the ray's line meets the triangle (a, b, c) at a t > 0. If so t, and the weights v of b and w of c.
    auto meet_triangle = [](const ShearedRay& r, float ax, float ay, float az, float bx, float by, float bz,
                            float cx, float cy, float cz, float& t, float& v, float& w) -> bool {
    #if defined(__CUDA_ARCH__)
        auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
        auto lesser = [](float a, float b) -> float { return fminf(a, b); };
        auto greater = [](float a, float b) -> float { return fmaxf(a, b); };
    #else
        auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
        auto lesser = [](float a, float b) -> float { return a < b ? a : b; };
        auto greater = [](float a, float b) -> float { return a > b ? a : b; };
    #endif
        // corner (px, py, pz) with the origin at 0, in the order x, y, z of the permuted axes, and sheared
        auto shear = [&](float& px, float& py, float& pz) {
            const float x = px - r.ox, y = py - r.oy, z = pz - r.oz;
            pz = r.z == 0 ? x : r.z == 1 ? y : z;
            px = fused(-r.sx, pz, r.z == 0 ? y : r.z == 1 ? z : x);
            py = fused(-r.sy, pz, r.z == 0 ? z : r.z == 1 ? x : y);
        };
        // a b - c d, the sign exact (Kahan)
        auto difference = [&](float a, float b, float c, float d) -> float {
            const float product = c * d;
            const float error = fused(-c, d, product);
            return fused(a, b, -product) + error;
        };
        shear(ax, ay, az); shear(bx, by, bz); shear(cx, cy, cz);
        const float tiny = EDGE_TINY;
        float u = difference(cx, by, cy, bx);
        v = difference(ax, cy, ay, cx);
        w = difference(bx, ay, by, ax);
        const float least = lesser(lesser(u, v), w), most = greater(greater(u, v), w);
        if (least > tiny || most < -tiny) {
            const float r_sum = 1.0f / (u + v + w);
            u *= r_sum; v *= r_sum; w *= r_sum;
        } else if (least >= -tiny || most <= tiny) {
            // on or near an edge, or a triangle that is tiny or seen edge-on
            const double du = (double)cx * by - (double)cy * bx;
            const double dv = (double)ax * cy - (double)ay * cx;
            const double dw = (double)bx * ay - (double)by * ax;
            if ((du < 0.0 || dv < 0.0 || dw < 0.0) && (du > 0.0 || dv > 0.0 || dw > 0.0)) return false;
            const double sum = du + dv + dw;
            if (!(sum != 0.0)) return false;
            u = (float)(du / sum); v = (float)(dv / sum); w = (float)(dw / sum);
        } else {
            return false;
        }
        t = fused(w, cz, fused(v, bz, u * az)) * r.sz;
        return t > 0.0f;
    };
""".replace("EDGE_TINY", f"{EDGE_TINY.hex()}f")
