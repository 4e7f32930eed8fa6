"""Native text for rays in trees of the layout BOXES: what a ray carries, and what is done to it in one step.

`traverse_cpu.py` puts these parts into a native function, behind `VECTOR_TEXT`.
"""

from __future__ import annotations

from .intersect import EDGE_TINY
from .margin import DIRECTION_LEAST, SLAB_MARGIN

# Levels of a wide tree are no more than those of the binary tree, 63 at most; each leaves up to seven children waiting.
# Below them is the end of the stack, above them room for the eight words of a store.
STACK_MESH = 8 + 63 * 7 + 16
STACK_ALL = STACK_MESH + 63 * 7 + 16

RAY_TEXT = """
    constexpr int END = (int)0x80000000, LEAVE = END + 1;  // on the stack: the ray is done; it goes back to the top level
    constexpr int STACK = TWO_LEVEL ? STACK_ALL : STACK_MESH;
    // Where a ray is against boxes, by axis (the fourth is unused). A plane at p is met at fma(p, inverse, near) at the earliest and
    // fma(p, inverse, far) at the latest; `row` has the byte in a node where the near planes are, the far ones are at row ^ 32.
    struct alignas(64) Slabs {
        FourFloats inverse, near, far;
        FourInts row;
    };
    struct Carried {
        Slabs slabs;
        float best;            // distance of the closest hit so far, or t_max
        int child;             // where the ray goes next: a node, or a leaf's code below 0; `at` is its address
        const char* at;
        long long top;         // first free place of the stack
        // triangle test: axes x, y, z as `intersect.py` permutes them
        float ox, oy, oz, sx, sy, sz;
        int x, y, z;           // bytes from corner to coordinate in a group
        int slot, face;        // triangle of the closest hit so far, -1: none
        float v, w;            // weights of its second and third corner
        // instancing
        int entry, hit_entry;  // the tree that the ray is in (-1: the top level); that of the closest hit so far
        const char *nodes, *triangles;
        Slabs top_slabs;
        COUNTS_OF_RAY
        alignas(64) float distance[STACK];  // where waiting children are entered, rounded down; NaN at the ends
        alignas(64) int waiting[STACK];
    };
    // Rays are 128 bytes more than a multiple of 4096 apart, else they would share sets of the cache
    struct Ray : Carried { char apart[4096 - (sizeof(Carried) - 128) % 4096]; };
    const char* const NODES = (const char*)tree.nodes.data;
    const char* const TRIANGLES = (const char*)tree.triangles.data;
    const bool empty = tree.entry_count <= 0;
    // of the only tree, where there is one
    const char* const ONLY_NODES = TWO_LEVEL || empty ? NODES : NODES + 256ll * tree.entry_node.data[0];
    const char* const ONLY_TRIANGLES = TWO_LEVEL || empty ? TRIANGLES : TRIANGLES + 320ll * tree.entry_triangle.data[0];

    auto magnitude = [](FourFloats a) INLINE -> FourFloats { return (FourFloats)((FourInts)a & 0x7fffffff); };
    auto with_sign = [](FourFloats a, FourFloats sign) INLINE -> FourFloats {
        return (FourFloats)(((FourInts)a & 0x7fffffff) | ((FourInts)sign & (int)0x80000000));
    };
    auto largest = [](FourFloats a) INLINE -> FourFloats {
        FourFloats b = __builtin_shufflevector(a, a, 2, 3, 0, 1);
        a = a > b ? a : b;
        b = __builtin_shufflevector(a, a, 1, 0, 3, 2);
        return a > b ? a : b;
    };
    // Whether the ray can be traced. If not (it is not finite, or 0) planes could be NaN, and even places without a child be met.
    auto set_slabs = [&](Slabs& s, FourFloats o, FourFloats d, FourFloats centre, float margin) INLINE -> bool {
        const FourFloats c = o - centre, size = magnitude(d), least = largest(size) * DIRECTION_LEAST;
        const FourFloats raised = with_sign(size > least ? size : least, d), inverse = 1.0f / raised;
        const FourFloats back = with_sign(largest(magnitude(c)) * margin, raised);
        s.inverse = inverse;
        s.near = -(c + back) * inverse;
        s.far = -(c - back) * inverse;
        s.row = (((FourInts)raised >> 31) & 32) + FourInts{0, 64, 128, 0};
        const FourFloats finite = magnitude(inverse) + magnitude(s.near) + magnitude(s.far);
        return finite[0] + finite[1] + finite[2] < __builtin_inff() && largest(size)[0] < __builtin_inff();
    };
    auto set_shear = [&](Ray& ray, const float* o, const float* d) INLINE {
        const float ax = __builtin_fabsf(d[0]), ay = __builtin_fabsf(d[1]), az = __builtin_fabsf(d[2]);
        const int z = az > (ay > ax ? ay : ax) ? 2 : ay > ax ? 1 : 0, x = z == 2 ? 0 : z + 1, y = z == 0 ? 2 : z - 1;
        const FourFloats shear = FourFloats{d[x], d[y], 1.0f, 1.0f} / FourFloats{d[z], d[z], d[z], 1.0f};
        ray.sx = shear[0]; ray.sy = shear[1]; ray.sz = shear[2];
        ray.ox = o[x]; ray.oy = o[y]; ray.oz = o[z];
        ray.x = 32 * x; ray.y = 32 * y; ray.z = 32 * z;
    };
    // Into the tree of an entry, with the ray in its space (as `transform_point` and `transform_vector`); whether it can be traced
    auto set_entry = [&](Ray& ray, int entry) INLINE -> bool {
        const auto& p = origin.data[ray.slot];
        const auto& v = direction.data[ray.slot];
        const auto& c = tree.entry_centre.data[entry];
        float o[3] = {p[0], p[1], p[2]}, d[3] = {v[0], v[1], v[2]};
        if (TWO_LEVEL) {
            const auto& m = tree.entry_from_world.data[entry].data;
            for (int k = 0; k < 3; ++k) {
                o[k] = m[k][0] * p[0] + m[k][1] * p[1] + m[k][2] * p[2] + m[k][3];
                d[k] = m[k][0] * v[0] + m[k][1] * v[1] + m[k][2] * v[2];
            }
            ray.entry = entry;
            ray.nodes = NODES + 256ll * tree.entry_node.data[entry];
            ray.triangles = TRIANGLES + 320ll * tree.entry_triangle.data[entry];
        }
        ray.child = 0;
        ray.at = TWO_LEVEL ? ray.nodes : ONLY_NODES;
        set_shear(ray, o, d);
        return set_slabs(
            ray.slabs, FourFloats{o[0], o[1], o[2], 0.0f}, FourFloats{d[0], d[1], d[2], 0.0f}, FourFloats{c[0], c[1], c[2], 0.0f}, SLAB_MARGIN);
    };
"""

_RESET_TEXT = """\
    auto reset = [&](Ray& ray, int slot) INLINE {
        // where the hit will be written: slots of sorted rays are anywhere
        __builtin_prefetch(&hit_instance.data[slot], 1);
        if (!ANY_HIT) {
            __builtin_prefetch(&hit_t.data[slot], 1);
            __builtin_prefetch(&hit_primitive.data[slot], 1);
            __builtin_prefetch(&hit_uv.data[slot], 1);
        }
        ray.slot = slot;
        const float limit = t_max.data[slot];
        ray.best = limit > 0.0f ? limit : 0.0f;  // also where it is NaN, which would not end
        ray.face = -1;
        ray.v = ray.w = 0.0f;
        ray.top = 8;
        BEGIN_COUNTS
    };
"""

TO_TOP_TEXT = """\
    auto to_top = [&](Ray& ray) INLINE {
        ray.slabs = ray.top_slabs;
        ray.entry = -1;
        ray.nodes = NODES + 256ll * tree.top_node;
        ray.triangles = NODES;  // never read, but asked for ahead
    };
"""

_BEGIN_TEXT = """\
    // At the root; whether the ray can be traced
    auto begin = [&](Ray& ray, int slot) INLINE -> bool {
        reset(ray, slot);
        if (!TWO_LEVEL) return set_entry(ray, 0);
        const auto& p = origin.data[slot];
        const auto& v = direction.data[slot];
        const auto& c = tree.top_centre;
        const bool sound = set_slabs(
            ray.top_slabs, FourFloats{p[0], p[1], p[2], 0.0f}, FourFloats{v[0], v[1], v[2], 0.0f}, FourFloats{c[0], c[1], c[2], 0.0f},
            tree.top_margin);
        to_top(ray);
        ray.at = ray.nodes;
        ray.child = 0;
        return sound;
    };
"""

IDENTIFY_TEXT = """\
    // instance and primitive of triangle `face` of entry `e`
    auto identify = [&](int e, int face, int& instance, int& primitive) {
        instance = tree.entry_instance.data[e];
        primitive = face;
        if (instance >= 0) return;
        // the last whose first triangle is not beyond; without branches, which could not be foretold
        int low = tree.merged_first.data[e];
        for (int count = tree.merged_first.data[e + 1] - low; count > 1; count -= count >> 1) {
            const int middle = low + (count >> 1);
            low = __builtin_unpredictable(tree.merged_triangle_first.data[middle] <= face) ? middle : low;
        }
        instance = tree.merged_instance.data[low];
        primitive = face - tree.merged_triangle_first.data[low];
    };
"""

_FINISH_TEXT = """\
    auto finish = [&](Ray& ray) INLINE {
        const int slot = ray.slot;
        END_COUNTS
        if (ANY_HIT) { hit_instance.data[slot] = ray.face < 0 ? -1 : 0; return; }
        int instance = -1, primitive = -1;
        if (ray.face >= 0) identify(TWO_LEVEL ? ray.hit_entry : 0, ray.face, instance, primitive);
        hit_t.data[slot] = ray.best;
        hit_instance.data[slot] = instance;
        hit_primitive.data[slot] = primitive;
        hit_uv.data[slot] = wp::vec_t<2, float>(ray.v, ray.w);
    };
"""

STEP_TEXT = """
    auto ask_for = [](const char* p) INLINE {
        __builtin_prefetch(p); __builtin_prefetch(p + 64); __builtin_prefetch(p + 128); __builtin_prefetch(p + 192); __builtin_prefetch(p + 256);
    };
    // Address of a child. Nodes and leaves come in no order that a processor could guess: no branch.
    auto address = [&](const Ray& ray, int child) INLINE -> const char* {
        const char* node = NODES_OF_RAY + 256ll * NODE_OF_CHILD;
        const char* group = TRIANGLES_OF_RAY + 320ll * ((unsigned)~child >> 3);
        long long leaf = (long long)child >> 63;
        __asm__("" : "+r"(leaf));  // else the compiler finds a branch here
        return (const char*)(((long long)node & ~leaf) | ((long long)group & leaf));
    };
    // The node at `p`: which children the ray meets, and where it enters them
    auto meet = [&](Ray& ray, const char* p, Floats& enter) INLINE -> unsigned {
        const Slabs& s = ray.slabs;
        const Floats ix = all(s.inverse[0]), iy = all(s.inverse[1]), iz = all(s.inverse[2]);
        auto planes = [&](int row) INLINE -> Floats { return *(const Floats*)(p + row); };
        const Floats x0 = fused(planes(s.row[0]), ix, all(s.near[0])), x1 = fused(planes(s.row[0] ^ 32), ix, all(s.far[0]));
        const Floats y0 = fused(planes(s.row[1]), iy, all(s.near[1])), y1 = fused(planes(s.row[1] ^ 32), iy, all(s.far[1]));
        const Floats z0 = fused(planes(s.row[2]), iz, all(s.near[2])), z1 = fused(planes(s.row[2] ^ 32), iz, all(s.far[2]));
        enter = larger(larger(x0, y0), larger(z0, all(0.0f)));
        COUNT_NODE
        return at_most(enter, smaller(smaller(x1, y1), smaller(z1, all(ray.best))));
    };
    // These children go on the stack, the nearest on top; how many
    auto put_off = [&](Ray& ray, const char* p, Floats enter, unsigned met) INLINE -> int {
        // distances are not below 0, so that their bits are in order; the last three make room for the slot
        Ints key = compressed(((Ints)enter & ~7) | Ints{0, 1, 2, 3, 4, 5, 6, 7}, met);
        const int count = __builtin_popcount(met);
        key = __builtin_expect(count <= 4, 1) ? sorted_four(key) : sorted_eight(key);
        *(LooseInts*)(ray.waiting + ray.top) = picked(*(const Ints*)(p + 192), key & 7);
        *(LooseInts*)(ray.distance + ray.top) = key & ~7;KEEP_PLACES
        return count;
    };
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
        if (nearer) { ray.best = t; ray.face = face; ray.v = v; ray.w = w; if (TWO_LEVEL) ray.hit_entry = ray.entry; }
    };
    // The group of triangles at `p`
    auto test = [&](Ray& ray, const char* p) INLINE {
        const Floats ox = all(ray.ox), oy = all(ray.oy), oz = all(ray.oz), sx = all(-ray.sx), sy = all(-ray.sy);
        auto corner = [&](int row) INLINE -> Floats { return *(const Floats*)(p + row); };
        const Floats az = corner(ray.z) - oz, bz = corner(ray.z + 96) - oz, cz = corner(ray.z + 192) - oz;
        const Floats ax = fused(sx, az, corner(ray.x) - ox), ay = fused(sy, az, corner(ray.y) - oy);
        const Floats bx = fused(sx, bz, corner(ray.x + 96) - ox), by = fused(sy, bz, corner(ray.y + 96) - oy);
        const Floats cx = fused(sx, cz, corner(ray.x + 192) - ox), cy = fused(sy, cz, corner(ray.y + 192) - oy);
        const Ints face = *(const Ints*)(p + 288);
        const unsigned there = 0xffu ^ negative(face);
        COUNT_GROUP
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
        hits &= below(all(0.0f), t) & (ASKS_ANY ? below(t, all(ray.best)) : at_most(t, all(ray.best)));
        if (ASKS_ANY) {
            if (hits) { ray.face = 0; ray.top = 8; }
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
        while (__builtin_expect(more-- > 0, 0)) test(ray, p += 320);
    };
"""

_ENTER_TEXT = """\
    // A leaf of the top level was just taken from the stack: into its first entry, the others wait. Whether there is anything to see.
    auto enter_tree = [&](Ray& ray) INLINE -> bool {
        const int code = ~ray.child, entry = tree.top_entry.data[code >> 3];
        if (code & 7) {
            ray.waiting[ray.top] = ~(code + 7);  // one further, one less
            ray.distance[ray.top++] = 0.0f;  // an only child was never given one
        }
        if (visibility.shape[0] != 0 && !(tree.entry_visibility.data[entry] & visibility.data[ray.slot])) return false;
        if (!set_entry(ray, entry)) { to_top(ray); return false; }
        ray.waiting[ray.top] = LEAVE;
        ray.distance[ray.top++] = __builtin_nanf("");
        return true;
    };
"""

POP_TEXT = """\
    // The highest child on the stack that is not beyond the closest hit, or an end; it is taken off
    auto pop = [&](Ray& ray) INLINE -> int {
        const Floats best = all(ray.best);
        long long first = ray.top - 8;
        unsigned good;
        while (__builtin_expect((good = not_above(*(const LooseFloats*)(ray.distance + first), best)) == 0u, 0)) first -= 8;
        ray.top = first + 31 - __builtin_clz(good);
        return ray.waiting[ray.top];
    };
    auto clear_stack = [](Ray& ray) INLINE {
        for (int k = 0; k < 8; ++k) { ray.waiting[k] = END; ray.distance[k] = __builtin_nanf(""); }
    };
"""

# What kernels of whole trees put in place of these words
_WHOLE_TREE = {
    "NODES_OF_RAY": "(TWO_LEVEL ? ray.nodes : ONLY_NODES)",
    "TRIANGLES_OF_RAY": "(TWO_LEVEL ? ray.triangles : ONLY_TRIANGLES)",
    "NODE_OF_CHILD": "child",
    "KEEP_PLACES": "",
    "ASKS_ANY": "ANY_HIT",
}
_CONSTANTS = {
    "DIRECTION_LEAST": f"{DIRECTION_LEAST.hex()}f",
    "SLAB_MARGIN": f"{SLAB_MARGIN.hex()}f",
    "EDGE_TINY": f"{EDGE_TINY.hex()}f",
    "STACK_ALL": str(STACK_ALL),
    "STACK_MESH": str(STACK_MESH),
}


def filled(text: str, words: dict[str, str]) -> str:
    """`text` with other words in place of the keys of `words`, one after another."""
    for word, replacement in words.items():
        text = text.replace(word, replacement)
    return text


RAY_TEXT, STEP_TEXT = filled(RAY_TEXT, _CONSTANTS), filled(STEP_TEXT, _CONSTANTS)
WHOLE_TREE_TEXT = filled(
    RAY_TEXT + _RESET_TEXT + TO_TOP_TEXT + _BEGIN_TEXT + IDENTIFY_TEXT + _FINISH_TEXT + STEP_TEXT + _ENTER_TEXT + POP_TEXT, _WHOLE_TREE
)
