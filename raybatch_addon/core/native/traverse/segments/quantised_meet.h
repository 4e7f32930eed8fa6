// The lane's ray meets a segment: what stands in `quantised/test.h` in place of `meet_triangle`, so that segments
// accept hits as triangles do.

// a and b: its points; p, c: its block, and the third corner there, of the step behind where it deforms
auto meet_segment = [&](const Words& a, const Words& b, const Words* p, float& t, float& u, float& v) -> bool {
    const float o[3] = {ray.ox, ray.oy, ray.oz};
    const float d[3] = {reciprocal(ray.ix), reciprocal(ray.iy), reciprocal(ray.iz)};
    Axis axis;
    const Words c = read(p + 2);
    float r0 = as_float((c.x & RADIUS_MASK) << 15), r1 = as_float((c.x >> 16) << 15);
#if MOTION
    const Words before = read(p - TRIANGLE * between.next + 2);
    const float first = as_float((before.x & RADIUS_MASK) << 15), second = as_float((before.x >> 16) << 15);
    r0 = first + between.share * (r0 - first);
    r1 = second + between.share * (r1 - second);
    mixed_normal(before.y, c.y, between.share, axis.n);
    mixed_normal(before.z, c.z, between.share, axis.m);
#else
    segment_normal(c.y, axis.n);
    segment_normal(c.z, axis.m);
#endif
    const bool flat = (c.y & RIBBON) != 0u;
    const Segment g = {
        as_float(a.x), as_float(a.y), as_float(a.z), as_float(b.x), as_float(b.y), as_float(b.z), r0, r1
    };
    const Entry entry = flat ? enter_ribbon(o, d, g) : enter_segment(o, d, g);
    t = entry.t;
    if (!(entry.good >= 0.0f && t > 0.0f && t < 3e38f)) return false;
    const float q[3] = {entry.qx, entry.qy, entry.qz};
    axis.e[0] = g.bx - g.ax;
    axis.e[1] = g.by - g.ay;
    axis.e[2] = g.bz - g.az;
    if (flat) return place_on_ribbon(axis, d, r0 + entry.s * (r1 - r0), q, entry.s, u, v);
    return place_on_segment(axis, q, entry.s, u, v);
};
#undef test
#define test test_segment
#define meet_triangle(sheared, first, second, third, t, v, w) meet_segment(a, b, p, t, v, w)
