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
    const unsigned lane = threadIdx.x & 31u;
    auto as_float = [](unsigned x) -> float { return __uint_as_float(x); };
    auto as_bits = [](float x) -> int { return __float_as_int(x); };
    auto highest_bit = [](unsigned x) -> unsigned { return 31u - __clz(x); };
    auto bit_count = [](unsigned x) -> int { return __popc(x); };
    auto fused = [](float a, float b, float c) -> float { return __fmaf_rn(a, b, c); };
    auto byte = [](unsigned x, int j) -> float { return __uint_as_float(__byte_perm(x, 0x4b000000u, 0x7440 + j)) - 8388608.0f; };
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
    const unsigned lane = 0u;
    auto as_float = [](unsigned x) -> float { float r; __builtin_memcpy(&r, &x, 4); return r; };
    auto as_bits = [](float x) -> int { int r; __builtin_memcpy(&r, &x, 4); return r; };
    auto highest_bit = [](unsigned x) -> unsigned { return 31u - __builtin_clz(x); };
    auto bit_count = [](unsigned x) -> int { return __builtin_popcount(x); };
    auto fused = [](float a, float b, float c) -> float { return __builtin_fmaf(a, b, c); };
    auto byte = [](unsigned x, int j) -> float { return (float)((x >> (8 * j)) & 255u); };
    auto larger = [](float a, float b) -> float { return a > b ? a : b; };
    auto smaller = [](float a, float b) -> float { return a < b ? a : b; };
    auto ballot = [](bool p) -> unsigned { return p ? 1u : 0u; };
    auto read = [](const Words* p) -> Words { return *p; };
    auto reciprocal = [](float x) -> float { return 1.0f / x; };
    auto quotient = [](float a, float b, float reciprocal_b) -> float { return a / b; };
#endif
"""

# The ray in the space of the tree that it is in. `margin.py` has the reasons for both constants.
RAY_TEXT = """
    struct Ray {
        float ox, oy, oz;  // origin
        float ix, iy, iz;  // 1 / direction, no component of which is near 0
        float nx, ny, nz;  // a plane at p is met at fma(p, i, n) at the earliest,
        float fx, fy, fz;  // and at fma(p, i, f) at the latest
        float sx, sy;      // shear of the triangle test
        unsigned order;    // in each byte the octant that is visited first; in bits 5 and 6 the axis of the triangle test
    };
    auto begin_ray = [&](float ox, float oy, float oz, float dx, float dy, float dz, float cx, float cy, float cz, float margin) -> Ray {
        Ray r;
        r.ox = ox; r.oy = oy; r.oz = oz;
        const float ax = fabsf(dx), ay = fabsf(dy), az = fabsf(dz);
        const unsigned axis = az > (ay > ax ? ay : ax) ? 2u : ay > ax ? 1u : 0u;
        const float most = larger(larger(ax, ay), az), least = most * DIRECTION_LEAST;
        r.ix = reciprocal(ax < least ? wp::copysign(least, dx) : dx);
        r.iy = reciprocal(ay < least ? wp::copysign(least, dy) : dy);
        r.iz = reciprocal(az < least ? wp::copysign(least, dz) : dz);
        const float dm = axis == 0u ? dx : axis == 1u ? dy : dz, im = axis == 0u ? r.ix : axis == 1u ? r.iy : r.iz;
        r.sx = quotient(axis == 0u ? dy : axis == 1u ? dz : dx, dm, im);
        r.sy = quotient(axis == 0u ? dz : axis == 1u ? dx : dy, dm, im);
        const float x = ox - cx, y = oy - cy, z = oz - cz;
        const float reach = margin * larger(larger(fabsf(x), fabsf(y)), fabsf(z));
        const float ex = reach * fabsf(r.ix), ey = reach * fabsf(r.iy), ez = reach * fabsf(r.iz);
        r.nx = fused(-x, r.ix, -ex); r.ny = fused(-y, r.iy, -ey); r.nz = fused(-z, r.iz, -ez);
        r.fx = fused(-x, r.ix, ex); r.fy = fused(-y, r.iy, ey); r.fz = fused(-z, r.iz, ez);
        // slot bits: 4, 2, 1 towards +x, +y, +z
        r.order = (7u ^ ((r.ix < 0.0f ? 4u : 0u) | (r.iy < 0.0f ? 2u : 0u) | (r.iz < 0.0f ? 1u : 0u))) * 0x01010101u | axis << 5;
        return r;
    };
""".replace("DIRECTION_LEAST", f"{DIRECTION_LEAST.hex()}f")

# Which children of a node (words a to e) a ray meets before `limit`: in bits 24 to 31 inner nodes, the one to visit first
# highest; in bits 0 to 23 triangles of leaves.
#
# A byte becomes a float as the lowest byte of 2^23 + byte, less 2^23: both are exact. On CUDA distances are compared as
# integers, three at once: below 0 their order is another, but anything below 0 is a miss as an exit, and 0 as an entry.
NODE_TEXT = """
    auto meet_node = [&](const Ray& r, float limit, const Words& a, const Words& b, const Words& c, const Words& d, const Words& e) -> unsigned {
        const float sx = as_float((a.w << 23) & 0x7f800000u) * r.ix;
        const float sy = as_float((a.w << 15) & 0x7f800000u) * r.iy;
        const float sz = as_float((a.w << 7) & 0x7f800000u) * r.iz;
        const float nx = fused(as_float(a.x), r.ix, r.nx), fx = fused(as_float(a.x), r.ix, r.fx);
        const float ny = fused(as_float(a.y), r.iy, r.ny), fy = fused(as_float(a.y), r.iy, r.fy);
        const float nz = fused(as_float(a.z), r.iz, r.nz), fz = fused(as_float(a.z), r.iz, r.fz);
        unsigned hits = 0u;
    #pragma unroll
        for (int half = 0; half < 2; ++half) {
            const unsigned low_x = half ? c.y : c.x, low_y = half ? c.w : c.z, low_z = half ? d.y : d.x;
            const unsigned high_x = half ? d.w : d.z, high_y = half ? e.y : e.x, high_z = half ? e.w : e.z;
            const unsigned near_x = r.ix < 0.0f ? high_x : low_x, far_x = r.ix < 0.0f ? low_x : high_x;
            const unsigned near_y = r.iy < 0.0f ? high_y : low_y, far_y = r.iy < 0.0f ? low_y : high_y;
            const unsigned near_z = r.iz < 0.0f ? high_z : low_z, far_z = r.iz < 0.0f ? low_z : high_z;
            const unsigned meta = half ? b.w : b.z;
            // only an inner node has bits 3 and 4 of its place set: its slot becomes its rank in the ray's order
            const unsigned inner = (meta & (meta << 1)) & 0x10101010u;
            const unsigned place = meta ^ (r.order & ((inner >> 4) * 0x07u));
            const unsigned count = (meta >> 5) & 0x07070707u;
    #pragma unroll
            for (int j = 0; j < 4; ++j) {
                const float x0 = fused(byte(near_x, j), sx, nx), x1 = fused(byte(far_x, j), sx, fx);
                const float y0 = fused(byte(near_y, j), sy, ny), y1 = fused(byte(far_y, j), sy, fy);
                const float z0 = fused(byte(near_z, j), sz, nz), z1 = fused(byte(far_z, j), sz, fz);
    #if defined(__CUDA_ARCH__)
                const int enter = __vimax3_s32_relu(as_bits(x0), as_bits(y0), as_bits(z0));
                const int leave = __vimin3_s32(as_bits(x1), as_bits(y1), min(as_bits(z1), as_bits(limit)));
    #else
                const float enter = larger(larger(x0, y0), larger(z0, 0.0f));
                const float leave = smaller(smaller(x1, y1), smaller(z1, limit));
    #endif
                if (enter <= leave) hits |= ((count >> (8 * j)) & 7u) << ((place >> (8 * j)) & 31u);
            }
        }
        return hits;
    };
"""

# What a lane holds: a ray, a group of nodes to visit (the first of them, and from bit 24 which; below, which of the node's
# slots are inner) with more of them on its stack, and one or two groups of triangles to test (the first, and which).
# In the top level the triangles are entries, and such groups may be on the stack too.
LANE_TEXT = """
    const Words* nodes = (const Words*)tree.nodes.data;
    const Words* triangles = (const Words*)tree.triangles.data;
    auto is_nodes = [](const Group& g) -> bool { return g.y > 0x00ffffffu; };
    auto single_bit = [](unsigned x) -> bool { return (x & (x - 1u)) == 0u; };

    int depth = 0;                            // groups on the stack
    $stack
    $counters
    Group inner = {0u, 0u}, leaf = {0u, 0u};  // in hand
    Group later = {0u, 0u};                   // triangles of an earlier node; none unless `leaf` has some
    Ray ray = {};
    int slot = -1;                            // of the ray, -1: none
    bool alive = false;                       // the ray is under way
    bool turned = false;                      // it is new, or has come to another tree: `ray` is not made yet
    float best = 0.0f;                        // distance of the closest hit so far, or t_max
    int best_face = -1, best_entry = -1;      // its triangle; -1: no hit
    int entry = -1;                           // the tree that the ray is in, -1: the top level
    int bottom = 0;                           // groups on the stack that belong to the top level
    unsigned first_node = 0u, first_triangle = 0u;

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
    auto take = [&](int ray_slot) {
        slot = ray_slot;
        best = t_max.data[slot];
        best_face = best_entry = entry = -1;
        depth = bottom = 0;
        leaf.y = later.y = 0u;
        inner.x = TWO_LEVEL ? tree.top_node : 0u;
        inner.y = tree.entry_count > 0 ? 0x80000000u : 0u;
        turned = alive = true;
        $count_begin
    };
    auto finish = [&]() {
        if (ANY_HIT) {
            hit_instance.data[slot] = best_face;
        } else {
            int instance = -1, primitive = -1;
            if (best_face >= 0) identify(TWO_LEVEL ? best_entry : 0, best_face, instance, primitive);
            else hit_uv.data[slot] = wp::vec_t<2, float>(0.0f, 0.0f);
            hit_t.data[slot] = best;
            hit_instance.data[slot] = instance;
            hit_primitive.data[slot] = primitive;
        }
        $count_ray
        slot = -1;
    };
    // into the tree of an entry, what is left of the top level for later
    auto enter = [&]() {
        const unsigned bit = highest_bit(leaf.y);
        leaf.y ^= 1u << bit;
        const int e = tree.top_entry.data[leaf.x + bit];
        if ((tree.entry_visibility.data[e] & visibility.data[slot]) == 0) return;
        if (is_nodes(inner)) push(inner);
        if (leaf.y) push(leaf);
        leaf.y = 0u;
        bottom = depth;
        entry = e;
        inner.x = tree.entry_node.data[e];
        inner.y = 0x80000000u;
        turned = true;
    };
    auto make_ray = [&]() {
        turned = false;
        const auto o = origin.data[slot];
        const auto d = direction.data[slot];
        if (!TWO_LEVEL) {
            const auto c = tree.entry_centre.data[0];
            ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], SLAB_MARGIN);
        } else if (entry < 0) {
            const auto c = tree.top_centre;
            ray = begin_ray(o[0], o[1], o[2], d[0], d[1], d[2], c[0], c[1], c[2], tree.top_margin);
            first_node = tree.top_node;
            first_triangle = 0u;
        } else {
            // as `transform_point` and `transform_vector`
            const auto& m = tree.entry_from_world.data[entry].data;
            const auto c = tree.entry_centre.data[entry];
            ray = begin_ray(
                m[0][0] * o[0] + m[0][1] * o[1] + m[0][2] * o[2] + m[0][3], m[1][0] * o[0] + m[1][1] * o[1] + m[1][2] * o[2] + m[1][3],
                m[2][0] * o[0] + m[2][1] * o[1] + m[2][2] * o[2] + m[2][3], m[0][0] * d[0] + m[0][1] * d[1] + m[0][2] * d[2],
                m[1][0] * d[0] + m[1][1] * d[1] + m[1][2] * d[2], m[2][0] * d[0] + m[2][1] * d[1] + m[2][2] * d[2],
                c[0], c[1], c[2], SLAB_MARGIN);
            first_node = tree.entry_node.data[entry];
            first_triangle = tree.entry_triangle.data[entry];
        }
    };
    // one triangle of the group in hand
    auto test = [&]() {
        const unsigned bit = highest_bit(leaf.y);
        leaf.y ^= 1u << bit;
        const Words* p = triangles + 3ull * (leaf.x + bit);
        const Words a = read(p), b = read(p + 1), c = read(p + 2);
        if (leaf.y == 0u) { leaf = later; later.y = 0u; }
        $count_test
        const int axis = (ray.order >> 5) & 3u;
        const ShearedRay sheared = {ray.ox, ray.oy, ray.oz, ray.sx, ray.sy, axis == 0 ? ray.ix : axis == 1 ? ray.iy : ray.iz, axis};
        float t, v, w;
        if (!meet_triangle(sheared, as_float(a.x), as_float(a.y), as_float(a.z), as_float(b.x), as_float(b.y), as_float(b.z),
                           as_float(c.x), as_float(c.y), as_float(c.z), t, v, w)) return;
        const int face = (int)a.w;
        bool nearer = t < best;
        if (ANY_HIT) {
            if (nearer) { best_face = 0; alive = false; }
            return;
        }
        if (t == best) {
            if (!TWO_LEVEL || entry == best_entry) {
                nearer = face < best_face;
            } else if (best_entry >= 0) {
                int instance, primitive, best_instance, best_primitive;
                identify(entry, face, instance, primitive);
                identify(best_entry, best_face, best_instance, best_primitive);
                nearer = instance < best_instance || (instance == best_instance && primitive < best_primitive);
            }
        }
        if (nearer) {
            best = t;
            best_face = face;
            best_entry = entry;
            hit_uv.data[slot] = wp::vec_t<2, float>(v, w);
        }
    };
    Words a, b, c, d, e;
    // the next node of the group in hand is read,
    auto fetch = [&]() {
        const unsigned bit = highest_bit(inner.y), mask = inner.y;
        inner.y ^= 1u << bit;
        if (is_nodes(inner)) push(inner);
        const unsigned child = (bit ^ ray.order) & 7u;
        const Words* p = nodes + 5ull * (inner.x + bit_count(mask & ((1u << child) - 1u)));
        a = read(p); b = read(p + 1); c = read(p + 2); d = read(p + 3); e = read(p + 4);
    };
    // and what the ray meets in it is in hand
    auto visit = [&]() {
        $count_visit
        const unsigned hits = meet_node(ray, best, a, b, c, d, e);
        inner.x = b.x + first_node;
        inner.y = (hits & 0xff000000u) | a.w >> 24;
        if (hits & 0x00ffffffu) {
            later = leaf;
            leaf.x = b.y + first_triangle;
            leaf.y = hits & 0x00ffffffu;
        }
    };
    // on with what is on the stack; a tree that is done is left, and the ray ends in the top level
    auto go_on = [&]() {
        const bool in_mesh = !TWO_LEVEL || entry >= 0;
        if (is_nodes(inner) || (!in_mesh && leaf.y)) return;
        if (depth == bottom) {
            if (leaf.y) return;
            if (TWO_LEVEL && in_mesh) { entry = -1; bottom = 0; turned = true; }
            if (depth == 0) { alive = false; return; }
        }
        const Group g = pop();
        if (!TWO_LEVEL || is_nodes(g)) inner = g; else leaf = g;
    };
""".replace("SLAB_MARGIN", f"{SLAB_MARGIN.hex()}f")
