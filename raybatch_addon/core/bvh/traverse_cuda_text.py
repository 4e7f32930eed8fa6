"""Native text for rays in quantised trees: how a lane carries a ray, and how it meets a node.

C++ for both devices: on CUDA for a lane of a warp, on a CPU for the only lane there is. `traverse_cuda.py` puts these
parts into a native function, one behind another, after `TRIANGLE_TEXT`.
"""

from __future__ import annotations

from .margin import DIRECTION_LEAST, SLAB_MARGIN

# What differs between the devices
DEVICE_TEXT = """
#if defined(__CUDA_ARCH__)
    typedef uint4 Words;
    typedef uint2 Group;
    constexpr unsigned ALL_LANES = 0xffffffffu;
    auto lanes_below = []() -> unsigned { unsigned r; asm volatile("mov.u32 %0, %%lanemask_lt;" : "=r"(r)); return r; };
    auto as_float = [](unsigned x) -> float { return __uint_as_float(x); };
    auto as_bits = [](float x) -> int { return __float_as_int(x); };
    auto highest_bit = [](unsigned x) -> unsigned { return 31u - __clz(x); };
    auto bit_count = [](unsigned x) -> int { return __popc(x); };
    auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
    // The four bytes of a word, times 2^-24: that is what a byte says in the last place of a float16, below the normal ones
    constexpr unsigned BYTE_EXPONENT = 24u << 23;
    auto unpack = [](unsigned x, float* q) {
        const unsigned even = x & 0x00ff00ffu, odd = __byte_perm(x, 0u, 0x4341);
        asm("{ .reg .b16 l, h; mov.b32 {l, h}, %2; cvt.f32.f16 %0, l; cvt.f32.f16 %1, h; }" : "=f"(q[0]), "=f"(q[2]) : "r"(even));
        asm("{ .reg .b16 l, h; mov.b32 {l, h}, %2; cvt.f32.f16 %0, l; cvt.f32.f16 %1, h; }" : "=f"(q[1]), "=f"(q[3]) : "r"(odd));
    };
    auto larger = [](float a, float b) -> float { return fmaxf(a, b); };
    auto ballot = [](bool p) -> unsigned { return __ballot_sync(0xffffffffu, p); };
    auto read = [](const Words* p) -> Words { return __ldg(p); };
    // an ulp off at most, for which the margin has room
    auto reciprocal = [](float x) -> float { float r; asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(x)); return r; };
    auto quotient = [](float a, float b, float reciprocal_b) -> float { return a * reciprocal_b; };
#else
    struct Words { unsigned x, y, z, w; };
    struct Group { unsigned x, y; };
    constexpr unsigned ALL_LANES = 1u;
    auto lanes_below = []() -> unsigned { return 0u; };
    auto as_float = [](unsigned x) -> float { float r; __builtin_memcpy(&r, &x, 4); return r; };
    auto as_bits = [](float x) -> int { int r; __builtin_memcpy(&r, &x, 4); return r; };
    auto highest_bit = [](unsigned x) -> unsigned { return 31u - __builtin_clz(x); };
    auto bit_count = [](unsigned x) -> int { return __builtin_popcount(x); };
    auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
    constexpr unsigned BYTE_EXPONENT = 0u;
    auto unpack = [](unsigned x, float* q) {
        for (int j = 0; j < 4; ++j) q[j] = (float)((x >> (8 * j)) & 255u);
    };
    auto larger = [](float a, float b) -> float { return a > b ? a : b; };
    auto smaller = [](float a, float b) -> float { return a < b ? a : b; };
    auto ballot = [](bool p) -> unsigned { return p ? 1u : 0u; };
    auto read = [](const Words* p) -> Words { return *p; };
    auto reciprocal = [](float x) -> float { return 1.0f / x; };
    auto quotient = [](float a, float b, float reciprocal_b) -> float { return a / b; };
#endif
"""

# The ray in the space of the tree that it is in. `margin.py` has the reasons for both constants. Where it counts 24 u |o'| + 21 u M
# of the 32 that are there, the approximate reciprocals (2 u instead of u: of the edge functions' sum, of dz for t, and of dz for the
# shear, where a product comes too; once for a slab), bytes added to an origin, and `late` added to a near plane make it 30 and 28 here.
RAY_TEXT = """
    struct Ray {
        float ox, oy, oz;  // origin
        float ix, iy, iz;  // 1 / direction, no component of which is near 0
        float nx, ny, nz;  // a plane at p is met at fma(p, i, n) at the earliest,
        float late;        // and |i| times this later at the latest
        float sx, sy;      // shear of the triangle test
        unsigned order;    // in each byte the octant that is visited first; in bits 5 and 6 the axis of the triangle test
    };
    auto begin_ray = [&](float ox, float oy, float oz, float dx, float dy, float dz, float cx, float cy, float cz, float margin) -> Ray {
        Ray r;
        r.ox = ox; r.oy = oy; r.oz = oz;
        const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
        const int axis = az > (ay > ax ? ay : ax) ? 2 : ay > ax ? 1 : 0;
        const float most = larger(larger(ax, ay), az), least = most * DIRECTION_LEAST;
        r.ix = reciprocal(ax < least ? wp::copysign(least, dx) : dx);
        r.iy = reciprocal(ay < least ? wp::copysign(least, dy) : dy);
        r.iz = reciprocal(az < least ? wp::copysign(least, dz) : dz);
        const float d = along(axis, dx, dy, dz), inverse = along(axis, r.ix, r.iy, r.iz);
        r.sx = quotient(across(axis, dx, dy, dz), d, inverse);
        r.sy = quotient(across_too(axis, dx, dy, dz), d, inverse);
        const float x = ox - cx, y = oy - cy, z = oz - cz;
        const float reach = margin * larger(larger(fabsf(x), fabsf(y)), fabsf(z));
        const float ex = reach * fabsf(r.ix), ey = reach * fabsf(r.iy), ez = reach * fabsf(r.iz);
        r.nx = fused(-x, r.ix, -ex); r.ny = fused(-y, r.iy, -ey); r.nz = fused(-z, r.iz, -ez);
        r.late = 2.0f * reach;
        // slot bits: 4, 2, 1 towards +x, +y, +z
        r.order = (7u ^ ((r.ix < 0.0f ? 4u : 0u) | (r.iy < 0.0f ? 2u : 0u) | (r.iz < 0.0f ? 1u : 0u))) * 0x01010101u | (unsigned)axis << 5;
        return r;
    };
""".replace("DIRECTION_LEAST", f"{DIRECTION_LEAST.hex()}f")

# Which children of a node (words a to e) a ray meets before `limit`: in bits 24 to 31 inner nodes, the one to visit first
# highest; in bits 0 to 23 triangles of leaves.
#
# On CUDA distances are compared as the integers of their bits, three at once. Below 0 these have another order, but there an exit is a
# miss whatever it is, and an entry counts as 0.
NODE_TEXT = """
    auto meet_node = [&](const Ray& r, float limit, const Words& a, const Words& b, const Words& c, const Words& d, const Words& e) -> unsigned {
        const float sx = as_float(((a.w << 23) + BYTE_EXPONENT) & 0x7f800000u) * r.ix;
        const float sy = as_float(((a.w << 15) + BYTE_EXPONENT) & 0x7f800000u) * r.iy;
        const float sz = as_float(((a.w << 7) + BYTE_EXPONENT) & 0x7f800000u) * r.iz;
        const float nx = fused(as_float(a.x), r.ix, r.nx), fx = nx + fabsf(r.ix * r.late);
        const float ny = fused(as_float(a.y), r.iy, r.ny), fy = ny + fabsf(r.iy * r.late);
        const float nz = fused(as_float(a.z), r.iz, r.nz), fz = nz + fabsf(r.iz * r.late);
        unsigned hits = 0u;
    #pragma unroll
        for (int half = 0; half < 2; ++half) {
            const unsigned low_x = half ? c.y : c.x, low_y = half ? c.w : c.z, low_z = half ? d.y : d.x;
            const unsigned high_x = half ? d.w : d.z, high_y = half ? e.y : e.x, high_z = half ? e.w : e.z;
            float near_x[4], near_y[4], near_z[4], far_x[4], far_y[4], far_z[4];
            unpack(r.ix < 0.0f ? high_x : low_x, near_x); unpack(r.ix < 0.0f ? low_x : high_x, far_x);
            unpack(r.iy < 0.0f ? high_y : low_y, near_y); unpack(r.iy < 0.0f ? low_y : high_y, far_y);
            unpack(r.iz < 0.0f ? high_z : low_z, near_z); unpack(r.iz < 0.0f ? low_z : high_z, far_z);
            const unsigned meta = half ? b.w : b.z;
            // only an inner node has bits 3 and 4 of its place set: its slot becomes its rank in the ray's order
            const unsigned inner = (meta & (meta << 1)) & 0x10101010u;
            const unsigned place = meta ^ (r.order & ((inner >> 4) * 0x07u));
            const unsigned count = (meta >> 5) & 0x07070707u;
    #pragma unroll
            for (int j = 0; j < 4; ++j) {
                const float x0 = fused(near_x[j], sx, nx), x1 = fused(far_x[j], sx, fx);
                const float y0 = fused(near_y[j], sy, ny), y1 = fused(far_y[j], sy, fy);
                const float z0 = fused(near_z[j], sz, nz), z1 = fused(far_z[j], sz, fz);
    #if defined(__CUDA_ARCH__)
                const int enter = __vimax3_s32_relu(as_bits(x0), as_bits(y0), as_bits(z0));
                const int leave = __vimin3_s32(as_bits(x1), as_bits(y1), min(as_bits(z1), as_bits(limit)));
                // added where enter <= leave, by the units for products: those for integers have more to do than any other
                unsigned shift;
                asm("shf.l.wrap.b32 %0, 0, 1, %1;" : "=r"(shift) : "r"(place >> (8 * j)));
                asm("{ .reg .pred met; setp.le.s32 met, %1, %2; @met mad.lo.u32 %0, %3, %4, %0; }"
                    : "+r"(hits) : "r"(enter), "r"(leave), "r"(__byte_perm(count, 0u, 0x4440 + j)), "r"(shift));
    #else
                const float enter = larger(larger(x0, y0), larger(z0, 0.0f));
                const float leave = smaller(smaller(x1, y1), smaller(z1, limit));
                if (enter <= leave) hits += ((count >> (8 * j)) & 255u) << ((place >> (8 * j)) & 31u);
    #endif
            }
        }
        return hits;
    };
"""

# What a lane holds: a ray; the node that it visits next; the group of nodes that come after (the first of them, and from bit
# 24 which; below, which of the slots of their parent are inner) with more such groups on its stack; one or two groups of
# triangles to test (the first, and which). In the top level the triangles are entries, and such groups may be on the stack too.
# The triangle of the closest hit so far is in `hit_primitive`, its entry in `hit_instance`, until `finish` looks them up.
_STATE_TEXT = """
    constexpr unsigned NONE = 0xffffffffu;
    const Words* nodes = (const Words*)tree.nodes.data;
    const Words* triangles = (const Words*)tree.triangles.data;
    auto is_nodes = [](const Group& g) -> bool { return g.y > 0x00ffffffu; };

    int slot = -1;                            // of the ray, -1: none
    Ray ray = {};
    float best = 0.0f;                        // distance of the closest hit so far, or t_max
    unsigned node = NONE;
    Group inner = {0u, 0u}, leaf = {0u, 0u};
    Group later = {0u, 0u};                   // triangles of an earlier node; none unless `leaf` has some
    int depth = 0;                            // groups on the stack
    int entry = -1;                           // the tree that the ray is in, -1: the top level
    int bottom = 0;                           // groups on the stack that belong to the top level
    bool turned = false;                      // the ray has come to another tree, for which `ray` is not made yet
    unsigned first_node = 0u, first_triangle = 0u;
    unsigned top_order = 0u;                  // `ray.order` in the top level
    Group stack[$stack_size];
    $counters
"""

# Parts that `traverse_cuda_visit.py` has too
IDENTIFY_TEXT = """
    // instance and primitive of triangle `face` of entry `e`
    auto identify = [&](int e, int face, int& instance, int& primitive) {
        instance = tree.entry_instance.data[e];
        primitive = face;
        if (instance >= 0) return;
        int low = tree.merged_first.data[e], high = tree.merged_first.data[e + 1] - 1;
        while (low < high) {
            const int middle = (low + high + 1) >> 1;
            if (tree.merged_triangle_first.data[middle] <= face) low = middle; else high = middle - 1;
        }
        instance = tree.merged_instance.data[low];
        primitive = face - tree.merged_triangle_first.data[low];
    };
"""

MAKE_RAY_TEXT = """
    auto make_ray = [&]() {
        const auto o = origin.data[slot];
        const auto d = direction.data[slot];
        if (!TWO_LEVEL) {
            const auto c = tree.entry_centre.data[0];
            ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], SLAB_MARGIN);
        } else if (entry < 0) {
            const auto c = tree.top_centre;
            ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], tree.top_margin);
            top_order = ray.order;
            $go_to_top
        } else {
            // as `transform_point` and `transform_vector`
            const auto& m = tree.entry_from_world.data[entry].data;
            const auto c = tree.entry_centre.data[entry];
            ray = begin_ray(
                m[0][0] * o[0] + m[0][1] * o[1] + m[0][2] * o[2] + m[0][3], m[1][0] * o[0] + m[1][1] * o[1] + m[1][2] * o[2] + m[1][3],
                m[2][0] * o[0] + m[2][1] * o[1] + m[2][2] * o[2] + m[2][3], m[0][0] * d[0] + m[0][1] * d[1] + m[0][2] * d[2],
                m[1][0] * d[0] + m[1][1] * d[1] + m[1][2] * d[2], m[2][0] * d[0] + m[2][1] * d[1] + m[2][2] * d[2],
                c[0], c[1], c[2], SLAB_MARGIN);
            $go_to_entry
        }
    };
""".replace("SLAB_MARGIN", f"{SLAB_MARGIN.hex()}f")

_BEGIN_TEXT = """
    auto take = [&](int ray_slot) {
        slot = ray_slot;
        best = t_max.data[slot];
        if (ANY_HIT) hit_instance.data[slot] = -1; else hit_primitive.data[slot] = -1;
        node = tree.entry_count > 0 ? TWO_LEVEL ? tree.top_node : 0u : NONE;
        if (TWO_LEVEL) turned = true; else make_ray();
        $count_begin
    };
    auto finish = [&]() {
        if (!ANY_HIT) {
            const int face = hit_primitive.data[slot];
            int instance = -1, primitive = -1;
            if (face >= 0) identify(TWO_LEVEL ? hit_instance.data[slot] : 0, face, instance, primitive);
            else hit_uv.data[slot] = wp::vec_t<2, float>(0.0f, 0.0f);
            hit_t.data[slot] = best;
            hit_instance.data[slot] = instance;
            hit_primitive.data[slot] = primitive;
        }
        $count_ray
        slot = -1;
    };
    // into the tree of an entry; what is left of the top level comes later
    auto enter = [&]() {
        const unsigned bit = highest_bit(leaf.y);
        leaf.y ^= 1u << bit;
        const int e = tree.top_entry.data[leaf.x + bit];
        if (visibility.shape[0] != 0 && (tree.entry_visibility.data[e] & visibility.data[slot]) == 0) return;
        if (is_nodes(inner)) stack[depth++] = inner;
        if (leaf.y) stack[depth++] = leaf;
        inner.y = leaf.y = 0u;
        bottom = depth;
        entry = e;
        node = tree.entry_node.data[e];
        turned = true;
    };
"""

TEST_TEXT = """
    // one triangle of the group in hand
    auto test = [&]() {
        const unsigned bit = highest_bit(leaf.y);
        leaf.y ^= 1u << bit;
        const Words* p = triangles + 3ull * (leaf.x + bit);
        const Words a = read(p), b = read(p + 1), c = read(p + 2);
        if (leaf.y == 0u) { leaf = later; later.y = 0u; }
        $count_test
        const int axis = (ray.order >> 5) & 3u;
        const ShearedRay sheared = {ray.ox, ray.oy, ray.oz, ray.sx, ray.sy, along(axis, ray.ix, ray.iy, ray.iz), axis};
        float t, v, w;
        if (!meet_triangle(sheared, as_float(a.x), as_float(a.y), as_float(a.z), as_float(b.x), as_float(b.y), as_float(b.z),
                           as_float(c.x), as_float(c.y), as_float(c.z), t, v, w)) return;
        if ($any_hit) {
            if (t < best) {
                hit_instance.data[slot] = 0;
                inner.y = leaf.y = later.y = 0u;
                depth = bottom = 0;
                entry = -1;
                node = NONE;
                $end_any_hit
            }
            return;
        }
        if (!(t <= best)) return;
        const int face = (int)a.w;
        if (t == best) {
            const int other = hit_primitive.data[slot];
            if (other < 0) return;
            if (!TWO_LEVEL || entry == hit_instance.data[slot]) {
                if (face >= other) return;
            } else {
                int instance, primitive, best_instance, best_primitive;
                identify(entry, face, instance, primitive);
                identify(hit_instance.data[slot], other, best_instance, best_primitive);
                if (instance > best_instance || (instance == best_instance && primitive >= best_primitive)) return;
            }
        }
        best = t;
        hit_primitive.data[slot] = face;
        if (TWO_LEVEL) hit_instance.data[slot] = entry;
        hit_uv.data[slot] = wp::vec_t<2, float>(v, w);
    };
"""

_STEP_TEXT = """
    // the node
    auto visit = [&]() {
        if (is_nodes(inner)) stack[depth++] = inner;
        const Words* p = nodes + 5ull * node;
        const Words a = read(p), b = read(p + 1), c = read(p + 2), d = read(p + 3), e = read(p + 4);
        $count_visit
        const unsigned hits = meet_node(ray, best, a, b, c, d, e);
        node = NONE;
        inner.x = b.x + first_node;
        inner.y = (hits & 0xff000000u) | a.w >> 24;
        if (hits & 0x00ffffffu) {
            later = leaf;
            leaf.x = b.y + first_triangle;
            leaf.y = hits & 0x00ffffffu;
        }
    };
    // the next node: of the group, else of the stack; a tree that is done is left, and the ray is done where the top level is
    auto choose = [&]() {
        const bool in_mesh = !TWO_LEVEL || entry >= 0;
        if (!in_mesh && leaf.y) return;
        if (!is_nodes(inner)) {
            if (depth == bottom) {
                if (leaf.y) return;
                if (TWO_LEVEL && in_mesh) {
                    entry = -1;
                    bottom = 0;
                    turned = true;
                }
                if (depth == 0) return;
            }
            const Group g = stack[--depth];
            if (TWO_LEVEL && !is_nodes(g)) { leaf = g; return; }
            inner = g;
        }
        const unsigned bit = highest_bit(inner.y), mask = inner.y;
        inner.y ^= 1u << bit;
        const unsigned child = (bit ^ (TWO_LEVEL && entry < 0 ? top_order : ray.order)) & 7u;
        node = inner.x + bit_count(mask & ((1u << child) - 1u));
    };
"""

LANE_TEXT = _STATE_TEXT + IDENTIFY_TEXT + MAKE_RAY_TEXT + _BEGIN_TEXT + TEST_TEXT + _STEP_TEXT
