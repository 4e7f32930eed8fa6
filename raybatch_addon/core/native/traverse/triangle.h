// The triangle test (`intersect.py`) of one ray and one triangle, on either device.

// Coordinates (x, y, z) in the ray's own axes, the last of which is `axis` 0..2. On a CPU the others follow in cycle.
// On CUDA it changes places with z, for which there is less to select; that may mirror a triangle, which is met from
// both sides anyway.
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
struct Corner {
    float x, y, z;
};
// Constants of the ray (o, d). d is not 0, of any length.
auto shear_ray = [&](float ox, float oy, float oz, float dx, float dy, float dz) -> ShearedRay {
    ShearedRay r;
    const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
    r.ox = ox;
    r.oy = oy;
    r.oz = oz;
    r.z = ay > ax ? 1 : 0;
    if (az > (ay > ax ? ay : ax)) r.z = 2;
    const float d = along(r.z, dx, dy, dz);
    r.sx = across(r.z, dx, dy, dz) / d;
    r.sy = across_too(r.z, dx, dy, dz) / d;
    r.sz = 1.0f / d;
    return r;
};
// Whether the ray's line meets the triangle (a, b, c) at a t > 0. If so t, and the weights v of b and w of c.
auto meet_triangle = [&](const ShearedRay& r, Corner a, Corner b, Corner c, float& t, float& v, float& w) -> bool {
#if defined(__CUDA_ARCH__)
    auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
    auto lesser = [](float a, float b) -> float { return fminf(a, b); };
    auto bits = [](float a) -> int { return __float_as_int(a); };
    // an ulp off at most, for which the margin has room
    auto reciprocal = [](float a) -> float {
        float q;
        asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(q) : "f"(a));
        return q;
    };
    auto quotient = [](double a, double b, double reciprocal_b) -> float { return (float)(a * reciprocal_b); };
#else
    auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
    auto lesser = [](float a, float b) -> float { return a < b ? a : b; };
    auto bits = [](float a) -> int {
        int i;
        __builtin_memcpy(&i, &a, 4);
        return i;
    };
    auto reciprocal = [](float a) -> float { return 1.0f / a; };
    auto quotient = [](double a, double b, double reciprocal_b) -> float { return (float)(a / b); };
#endif
    // a corner with the origin at 0, in the ray's own axes, and sheared
    auto shear = [&](Corner& p) {
        const float x = p.x - r.ox, y = p.y - r.oy, z = p.z - r.oz;
        p.z = along(r.z, x, y, z);
        p.x = fused(-r.sx, p.z, across(r.z, x, y, z));
        p.y = fused(-r.sy, p.z, across_too(r.z, x, y, z));
    };
    // a b - c d, the sign exact (Kahan)
    auto difference = [&](float a, float b, float c, float d) -> float {
        const float product = c * d;
        const float error = fused(-c, d, product);
        return fused(a, b, -product) + error;
    };
    shear(a);
    shear(b);
    shear(c);
    float u = difference(c.x, b.y, c.y, b.x);
    v = difference(a.x, c.y, a.y, c.x);
    w = difference(b.x, a.y, b.y, a.x);
    // Where signs differ the sum counts as infinite: the weights are 0, and t is not above 0. (The highest bit is the
    // sign.)
    if (lesser(lesser(fabsf(u), fabsf(v)), fabsf(w)) > EDGE_TINY) {
        const float q = reciprocal(((bits(u) ^ bits(v)) | (bits(u) ^ bits(w))) < 0 ? INFINITY : u + v + w);
        u *= q;
        v *= q;
        w *= q;
    } else {
        // on or near the line of an edge, or a triangle that is tiny or seen edge-on (then all are 0, and t is no
        // number)
        const double du = (double)c.x * b.y - (double)c.y * b.x;
        const double dv = (double)a.x * c.y - (double)a.y * c.x;
        const double dw = (double)b.x * a.y - (double)b.y * a.x;
        const bool differ = (du < 0.0 || dv < 0.0 || dw < 0.0) && (du > 0.0 || dv > 0.0 || dw > 0.0);
        const double sum = differ ? (double)INFINITY : du + dv + dw, q = 1.0 / sum;
        u = quotient(du, sum, q);
        v = quotient(dv, sum, q);
        w = quotient(dw, sum, q);
    }
    t = fused(w, c.z, fused(v, b.z, u * a.z)) * r.sz;
    return t > 0.0f;
};
