// The lane's ray meets a segment: what stands in `quantised/test.h` in place of `meet_triangle`, so that segments accept
// hits as triangles do.

// a and b: its points; p, c: its block, and the third corner there, of the step behind where it deforms
auto meet_segment = [&](const Words& a, const Words& b, const Words* p, float& t, float& u, float& v) -> bool {
    const float o[3] = {ray.ox, ray.oy, ray.oz};
    const float d[3] = {reciprocal(ray.ix), reciprocal(ray.iy), reciprocal(ray.iz)};
    const float ax = as_float(a.x), ay = as_float(a.y), az = as_float(a.z);
    const float bx = as_float(b.x), by = as_float(b.y), bz = as_float(b.z);
    const Words c = read(p + 2);
    float r0 = as_float((c.x & RADIUS_MASK) << 15), r1 = as_float((c.x >> 16) << 15), n[3], m[3];
#if MOTION
    const Words before = read(p - TRIANGLE * between.next + 2);
    const float first = as_float((before.x & RADIUS_MASK) << 15), second = as_float((before.x >> 16) << 15);
    r0 = first + between.share * (r0 - first);
    r1 = second + between.share * (r1 - second);
    mixed_normal(before.y, c.y, between.share, n);
    mixed_normal(before.z, c.z, between.share, m);
#else
    segment_normal(c.y, n);
    segment_normal(c.z, m);
#endif
    const bool flat = (c.y & RIBBON) != 0u;
    float s, q[3], good;
    if (flat) enter_ribbon(o, d, ax, ay, az, bx, by, bz, r0, r1, t, s, q[0], q[1], q[2], good);
    else enter_segment(o, d, ax, ay, az, bx, by, bz, r0, r1, t, s, q[0], q[1], q[2], good);
    if (!(good >= 0.0f && t > 0.0f && t < 3e38f)) return false;
    const float e[3] = {bx - ax, by - ay, bz - az};
    if (flat) return place_on_ribbon(e, d, r0 + s * (r1 - r0), n, m, q, s, u, v);
    return place_on_segment(e, n, m, q, s, u, v);
};
#undef test
#define test test_segment
#define meet_triangle(sheared, ax, ay, az, bx, by, bz, cx, cy, cz, t, v, w) meet_segment(a, b, p, t, v, w)
