// A ray of a tree of the layout BOXES meets leaves of triangles and segments.

#undef test_leaf
// Third corners are no points: bytes in a group of their words for eight segments
constexpr int RADII = 6 * GROUP_ROW, FIRST_PLANE = 7 * GROUP_ROW, SECOND_PLANE = 8 * GROUP_ROW;
// The segments of the group at `p` whose bits are in `marked`
auto test_segments = [&](Ray& ray, const char* p, unsigned marked) INLINE {
    float o[3], d[3];
    o[ray.x >> 5] = ray.ox;
    o[ray.y >> 5] = ray.oy;
    o[ray.z >> 5] = ray.oz;
    for (int k = 0; k < 3; ++k) d[k] = 1.0f / ray.slabs.inverse[k];
    const Ints face = *(const Ints*)(p + GROUP_FACE);
    auto radius_of = [&](const char* group, int shift) INLINE -> Floats {
        return (Floats)((*(const Ints*)(group + RADII) >> shift & RADIUS_MASK) << RADIUS_SHIFT);
    };
#if MOTION
    const char *before = p + ray.between.first, *behind = before + ray.between.next;
    const float share = ray.between.share;
    auto row = [&](int k) INLINE -> Floats {
        const Floats a = *(const Floats*)(before + GROUP_ROW * k), b = *(const Floats*)(behind + GROUP_ROW * k);
        const Floats low = smaller(a, b), high = larger(a, b), mixed = a + all(share) * (b - a);
        return smaller(larger(mixed, low), high);
    };
    auto radius = [&](int shift) INLINE -> Floats {
        const Floats a = radius_of(before, shift);
        return a + all(share) * (radius_of(behind, shift) - a);
    };
    auto normal = [&](int word, float* n) INLINE {
        mixed_normal(((const unsigned*)before)[word], ((const unsigned*)behind)[word], share, n);
    };
    p = before;
#else
    auto row = [&](int k) INLINE -> Floats { return *(const Floats*)(p + GROUP_ROW * k); };
    auto radius = [&](int shift) INLINE -> Floats { return radius_of(p, shift); };
    auto normal = [&](int word, float* n) INLINE { segment_normal(((const unsigned*)p)[word], n); };
#endif
    const Segment g = {row(0), row(1), row(2), row(3), row(4), row(5), radius(0), radius(RADIUS_BITS)};
#if COUNTERS
    ray.triangle_tests += __builtin_popcount(marked);
#endif
    const Floats limit = all(ray.best), finite = all(3e38f);
    const unsigned ribbons = marked & negative(*(const Ints*)(p + FIRST_PLANE) << (31 - RIBBON_BIT));
    // of ribbons or of others, which `chosen` says
    auto test_alike = [&](unsigned chosen, bool flat) INLINE {
        const Entry entry = flat ? enter_ribbon(o, d, g) : enter_segment(o, d, g);
        unsigned hits = chosen & at_most(all(0.0f), entry.good) & below(all(0.0f), entry.t) & below(entry.t, finite);
        hits &= asks_any(ray) ? below(entry.t, limit) : at_most(entry.t, limit);
        for (; hits; hits &= hits - 1u) {
            const int k = __builtin_ctz(hits);
            auto element = [&](const Floats& x) INLINE -> float { return ((const float*)&x)[k]; };
            Axis axis = {
                {element(g.bx) - element(g.ax), element(g.by) - element(g.ay), element(g.bz) - element(g.az)}, {}, {}
            };
            const float q[3] = {element(entry.qx), element(entry.qy), element(entry.qz)}, s = element(entry.s);
            float u, v;
            normal(FIRST_PLANE / 4 + k, axis.n);
            normal(SECOND_PLANE / 4 + k, axis.m);
            if (flat) {
                const float width = element(g.r0) + s * (element(g.r1) - element(g.r0));
                if (!place_on_ribbon(axis, d, width, q, s, u, v)) continue;
            } else if (!place_on_segment(axis, q, s, u, v)) continue;
            if (asks_any(ray)) {
                ray.face = 0;
                ray.top = 8;
                return;
            }
            keep(ray, element(entry.t), ((const int*)&face)[k], u, v);
        }
    };
    if (marked != ribbons) test_alike(marked & ~ribbons, false);
    if (ribbons) test_alike(ribbons, true);
};
// The leaf that `child` and `at` say
auto test_leaf = [&](Ray& ray) INLINE {
    const char* p = ray.at;
    for (int more = (unsigned)~ray.child & 7; more >= 0; --more, p += GROUP) {
        const Floats mark = *(const Floats*)(p + SECOND_PLANE);
        const unsigned marked = not_above(mark, mark) & ~at_most(mark, mark);
        const unsigned there = 0xffu ^ negative(*(const Ints*)(p + GROUP_FACE));
        if (marked != there) test(ray, p);
        if (marked) test_segments(ray, p, marked);
    }
};
