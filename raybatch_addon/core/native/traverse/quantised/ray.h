// A ray in the space of the quantised tree that it is in.
//
// `margin.py` has the reasons for both constants. Where it counts 24 u |o'| + 21 u M of the 32 that are there, the
// approximate reciprocals (2 u instead of u: of the edge functions' sum, of dz for t, and of dz for the shear, where a
// product comes too; once for a slab), bytes added to an origin, and `late` added to a near plane make it 30 and 28
// here.

struct Ray {
    float ox, oy, oz;  // origin
    float ix, iy, iz;  // 1 / direction, no component of which is near 0
    float nx, ny, nz;  // a plane at p is met at fma(p, i, n) at the earliest,
    float late;        // and |i| times this later at the latest
    float sx, sy;      // shear of the triangle test
    unsigned order;    // in each byte the octant that is visited first; in bits 5 and 6 the axis of the triangle test
};
// The ray (o, d) in a tree around the point c
auto begin_ray = [&](const wp::vec_t<3, float>& o, const wp::vec_t<3, float>& d, const wp::vec_t<3, float>& c,
                     float margin) -> Ray {
    const float dx = d[0], dy = d[1], dz = d[2];
    Ray r;
    r.ox = o[0];
    r.oy = o[1];
    r.oz = o[2];
    const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
    const int axis = az > (ay > ax ? ay : ax) ? 2 : ay > ax ? 1 : 0;
    const float most = larger(larger(ax, ay), az), least = most * DIRECTION_LEAST;
    r.ix = reciprocal(ax < least ? wp::copysign(least, dx) : dx);
    r.iy = reciprocal(ay < least ? wp::copysign(least, dy) : dy);
    r.iz = reciprocal(az < least ? wp::copysign(least, dz) : dz);
    const float dominant = along(axis, dx, dy, dz), inverse = along(axis, r.ix, r.iy, r.iz);
    r.sx = quotient(across(axis, dx, dy, dz), dominant, inverse);
    r.sy = quotient(across_too(axis, dx, dy, dz), dominant, inverse);
    const float x = r.ox - c[0], y = r.oy - c[1], z = r.oz - c[2];
    const float reach = margin * larger(larger(fabsf(x), fabsf(y)), fabsf(z));
    const float ex = reach * fabsf(r.ix), ey = reach * fabsf(r.iy), ez = reach * fabsf(r.iz);
    r.nx = fused(-x, r.ix, -ex);
    r.ny = fused(-y, r.iy, -ey);
    r.nz = fused(-z, r.iz, -ez);
    r.late = 2.0f * reach;
    // octant bits: 4, 2, 1 towards +x, +y, +z
    const unsigned octant = (r.ix < 0.0f ? 4u : 0u) | (r.iy < 0.0f ? 2u : 0u) | (r.iz < 0.0f ? 1u : 0u);
    r.order = (7u ^ octant) * 0x01010101u | (unsigned)axis << 5;
    return r;
};
