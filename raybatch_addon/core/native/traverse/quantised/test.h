// The lane tests one triangle of the group in hand.

auto test = [&]() {
    const unsigned bit = highest_bit(leaf.y);
    leaf.y ^= 1u << bit;
    const Words* p = triangles + TRIANGLE * (leaf.x + bit);
#if MOTION
    p += TRIANGLE * between.first;
    Words a = read(p), b = read(p + 1), c = read(p + 2);
    if (between.next) {
        p += TRIANGLE * between.next;
        const Words d = read(p), e = read(p + 1), f = read(p + 2);
        // never beyond the corners of both steps, so that boxes around these hold it
        auto mix = [&](unsigned& before, unsigned behind) {
            const float x = as_float(before), y = as_float(behind), z = x + between.share * (y - x);
            const float low = x < y ? x : y, high = x < y ? y : x;
            before = (unsigned)as_bits(z < low ? low : z > high ? high : z);
        };
        mix(a.x, d.x);
        mix(a.y, d.y);
        mix(a.z, d.z);
        mix(b.x, e.x);
        mix(b.y, e.y);
        mix(b.z, e.z);
        mix(c.x, f.x);
        mix(c.y, f.y);
        mix(c.z, f.z);
    }
#else
    const Words a = read(p), b = read(p + 1), c = read(p + 2);
#endif
    if (leaf.y == 0u) {
        leaf = later;
        later.y = 0u;
    }
#if COUNTERS
    count_lanes(2, true);
    ++tests;
#endif
    const int axis = (ray.order >> 5) & 3u;
    const ShearedRay sheared = {ray.ox, ray.oy, ray.oz, ray.sx, ray.sy, along(axis, ray.ix, ray.iy, ray.iz), axis};
    auto corner = [&](const Words& p) -> Corner { return {as_float(p.x), as_float(p.y), as_float(p.z)}; };
    float t, v, w;
    if (!meet_triangle(sheared, corner(a), corner(b), corner(c), t, v, w)) return;
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
    if (!(t <= best)) return;
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
    rays.hit_uv.data[slot] = wp::vec_t<2, float>(v, w);
};
