// A ray of a tree of the layout BOXES meets groups of eight triangles (`intersect.py`), and keeps the closest hit.

#if TREELETS
auto asks_any = [](const Ray& ray) INLINE -> bool { return ray.any; };
#else
auto asks_any = [](const Ray&) INLINE -> bool { return ANY_HIT; };
#endif
// A hit of triangle `face` at the distance t
auto keep = [&](Ray& ray, float t, int face, float v, float w) INLINE {
    bool nearer = t < ray.best;
    if (__builtin_expect(t == ray.best && ray.face >= 0, 0)) {
        if (!TWO_LEVEL || ray.entry == ray.hit_entry) {
            nearer = face < ray.face;
        } else {
            int instance, primitive, best_instance, best_primitive;
            identify(ray.entry, face, instance, primitive);
            identify(ray.hit_entry, ray.face, best_instance, best_primitive);
            nearer = instance < best_instance || (instance == best_instance && primitive < best_primitive);
        }
    }
    if (nearer) {
        ray.best = t;
        ray.face = face;
        ray.v = v;
        ray.w = w;
        if (TWO_LEVEL) ray.hit_entry = ray.entry;
    }
};
// The group of triangles at `p`
auto test = [&](Ray& ray, const char* p) INLINE {
    const Floats ox = all(ray.ox), oy = all(ray.oy), oz = all(ray.oz), sx = all(-ray.sx), sy = all(-ray.sy);
#if MOTION
    // never beyond the corners of both steps, so that boxes around these hold it
    const char *before = p + ray.between.first, *behind = before + ray.between.next;
    auto corner = [&](int row) INLINE -> Floats {
        const Floats a = *(const Floats*)(before + row), b = *(const Floats*)(behind + row);
        const Floats low = smaller(a, b), high = larger(a, b), mixed = a + all(ray.between.share) * (b - a);
        return smaller(larger(mixed, low), high);
    };
#else
    auto corner = [&](int row) INLINE -> Floats { return *(const Floats*)(p + row); };
#endif
    const Floats az = corner(ray.z) - oz, bz = corner(ray.z + 96) - oz, cz = corner(ray.z + 192) - oz;
    const Floats ax = fused(sx, az, corner(ray.x) - ox), ay = fused(sy, az, corner(ray.y) - oy);
    const Floats bx = fused(sx, bz, corner(ray.x + 96) - ox), by = fused(sy, bz, corner(ray.y + 96) - oy);
    const Floats cx = fused(sx, cz, corner(ray.x + 192) - ox), cy = fused(sy, cz, corner(ray.y + 192) - oy);
    const Ints face = *(const Ints*)(p + GROUP_FACE);
    const unsigned there = 0xffu ^ negative(face);
#if COUNTERS
    ray.triangle_tests += __builtin_popcount(there);
#endif
    const Floats u = difference(cx, by, cy, bx), v = difference(ax, cy, ay, cx), w = difference(bx, ay, by, ax);
    const Floats least = smaller(smaller(u, v), w), most = larger(larger(u, v), w), tiny = all(EDGE_TINY);
    unsigned hits = below(tiny, least) | below(most, -tiny);
    unsigned unsure = (at_most(-tiny, least) | at_most(most, tiny)) & ~hits & there;
    // most groups are missed altogether, but a division costs less than to guess which
    const Floats r = all(1.0f) / (u + v + w);
    Floats vr = v * r, wr = w * r, t = fused(wr, cz, fused(vr, bz, u * r * az)) * all(ray.sz);
    for (; __builtin_expect(unsure != 0u, 0); unsure &= unsure - 1u) {
        const int k = __builtin_ctz(unsure);
        const double du = (double)cx[k] * by[k] - (double)cy[k] * bx[k];
        const double dv = (double)ax[k] * cy[k] - (double)ay[k] * cx[k];
        const double dw = (double)bx[k] * ay[k] - (double)by[k] * ax[k];
        if ((du < 0.0 || dv < 0.0 || dw < 0.0) && (du > 0.0 || dv > 0.0 || dw > 0.0)) continue;
        const double sum = du + dv + dw;
        if (!(sum != 0.0)) continue;
        const float fu = (float)(du / sum), fv = (float)(dv / sum), fw = (float)(dw / sum);
        t[k] = __builtin_fmaf(fw, cz[k], __builtin_fmaf(fv, bz[k], fu * az[k])) * ray.sz;
        vr[k] = fv;
        wr[k] = fw;
        hits |= 1u << k;
    }
    hits &= below(all(0.0f), t) & (asks_any(ray) ? below(t, all(ray.best)) : at_most(t, all(ray.best)));
    if (asks_any(ray)) {
        if (hits) {
            ray.face = 0;
            ray.top = 8;
        }
        return;
    }
    if (hits == 0u) return;
    // most groups that are hit are hit more than once: only the nearest hits count
    const Floats reached = (all_ints((int)hits) & Ints{1, 2, 4, 8, 16, 32, 64, 128}) != 0 ? t : all(__builtin_inff());
    Floats nearest = smaller(reached, __builtin_shufflevector(reached, reached, 4, 5, 6, 7, 0, 1, 2, 3));
    nearest = smaller(nearest, __builtin_shufflevector(nearest, nearest, 2, 3, 0, 1, 6, 7, 4, 5));
    nearest = smaller(nearest, __builtin_shufflevector(nearest, nearest, 1, 0, 3, 2, 5, 4, 7, 6));
    for (hits &= at_most(reached, nearest); hits; hits &= hits - 1u) {
        const int k = __builtin_ctz(hits);
        keep(ray, ((const float*)&t)[k], ((const int*)&face)[k], ((const float*)&vr)[k], ((const float*)&wr)[k]);
    }
};
// The leaf that `child` and `at` say
auto test_leaf = [&](Ray& ray) INLINE {
    const char* p = ray.at;
    int more = (unsigned)~ray.child & 7;
    test(ray, p);
    while (__builtin_expect(more-- > 0, 0)) test(ray, p += GROUP);
};
