// A ray of a tree of the layout BOXES meets leaves of triangles and segments.

#undef test_leaf
// The segments of the group at `p` whose bits are in `marked`
auto test_segments = [&](Ray& ray, const char* p, unsigned marked) INLINE {
    float o[3], d[3];
    o[ray.x >> 5] = ray.ox;
    o[ray.y >> 5] = ray.oy;
    o[ray.z >> 5] = ray.oz;
    for (int k = 0; k < 3; ++k) d[k] = 1.0f / ray.slabs.inverse[k];
    auto row = [&](int k) INLINE -> Floats { return *(const Floats*)(p + 32 * k); };
    const Ints radii = (Ints)row(6), face = *(const Ints*)(p + GROUP_FACE);
    const Floats r0 = (Floats)((radii & (int)RADIUS_MASK) << 15);
    const Floats r1 = (Floats)((radii >> 16 & (int)RADIUS_MASK) << 15);
    Floats t, s, qx, qy, qz, good;
    enter_segment(o, d, row(0), row(1), row(2), row(3), row(4), row(5), r0, r1, t, s, qx, qy, qz, good);
#if COUNTERS
    ray.triangle_tests += __builtin_popcount(marked);
#endif
    const Floats limit = all(ray.best), finite = all(3e38f);
    unsigned hits = marked & at_most(all(0.0f), good) & below(all(0.0f), t) & below(t, finite);
    hits &= asks_any(ray) ? below(t, limit) : at_most(t, limit);
    for (; hits; hits &= hits - 1u) {
        const int k = __builtin_ctz(hits);
        const float* corners = (const float*)p + k;
        const float e[3] = {corners[24] - corners[0], corners[32] - corners[8], corners[40] - corners[16]};
        const float q[3] = {((const float*)&qx)[k], ((const float*)&qy)[k], ((const float*)&qz)[k]};
        const unsigned* bits = (const unsigned*)corners;
        float u, v;
        if (!place_on_segment(e, bits[56], bits[64], q, ((const float*)&s)[k], u, v)) continue;
        if (asks_any(ray)) {
            ray.face = 0;
            ray.top = 8;
            return;
        }
        keep(ray, ((const float*)&t)[k], ((const int*)&face)[k], u, v);
    }
};
// The leaf that `child` and `at` say
auto test_leaf = [&](Ray& ray) INLINE {
    const char* p = ray.at;
    for (int more = (unsigned)~ray.child & 7; more >= 0; --more, p += GROUP) {
        const Floats mark = *(const Floats*)(p + 256);
        const unsigned marked = not_above(mark, mark) & ~at_most(mark, mark);
        const unsigned there = 0xffu ^ negative(*(const Ints*)(p + GROUP_FACE));
        if (marked != there) test(ray, p);
        if (marked) test_segments(ray, p, marked);
    }
};
