// The lane tests one primitive of the group in hand, a triangle or a segment.

#undef test
auto test = [&]() {
    const unsigned bit = highest_bit(leaf.y);
    const Words* p = triangles + TRIANGLE * (leaf.x + bit);
    const Words c = read(p + 2);
    if ((c.z & 0x7fc00000u) != 0x7fc00000u) {
        test_triangle();
        return;
    }
    leaf.y ^= 1u << bit;
    if (leaf.y == 0u) {
        leaf = later;
        later.y = 0u;
    }
#if COUNTERS
    count_lanes(2, true);
    ++tests;
#endif
    const Words a = read(p), b = read(p + 1);
    const float o[3] = {ray.ox, ray.oy, ray.oz};
    const float d[3] = {reciprocal(ray.ix), reciprocal(ray.iy), reciprocal(ray.iz)};
    const float ax = as_float(a.x), ay = as_float(a.y), az = as_float(a.z);
    const float bx = as_float(b.x), by = as_float(b.y), bz = as_float(b.z);
    float t, s, q[3], good, u, v;
    enter_segment(
        o, d, ax, ay, az, bx, by, bz, as_float((c.x & RADIUS_MASK) << 15), as_float((c.x >> 16) << 15), t, s, q[0],
        q[1], q[2], good
    );
    if (!(good >= 0.0f && t > 0.0f && t < 3e38f && t <= best)) return;
    const float e[3] = {bx - ax, by - ay, bz - az};
    if (!place_on_segment(e, c.y, c.z, q, s, u, v)) return;
    if (asks_any()) {
        if (t < best) {
            rays.hit_instance.data[slot] = 0;
            inner.y = leaf.y = later.y = 0u;
            depth = bottom = 0;
            entry = -1;
            node = NONE;
            end_any();
        }
        return;
    }
    const int face = (int)a.w;
    if (t == best) {
        const int other = rays.hit_primitive.data[slot];
        if (other < 0) return;
        if (!TWO_LEVEL || entry == rays.hit_instance.data[slot]) {
            if (face >= other) return;
        } else {
            int instance, primitive, best_instance, best_primitive;
            identify(entry, face, instance, primitive);
            identify(rays.hit_instance.data[slot], other, best_instance, best_primitive);
            if (instance > best_instance || (instance == best_instance && primitive >= best_primitive)) return;
        }
    }
    best = t;
    rays.hit_primitive.data[slot] = face;
    if (TWO_LEVEL) rays.hit_instance.data[slot] = entry;
    rays.hit_uv.data[slot] = wp::vec_t<2, float>(u, v);
};
