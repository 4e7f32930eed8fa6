// A ray in trees of the layout BOXES: what it carries, and how it comes into a tree.

// on the stack: the ray is done; it goes back to the top level
constexpr int END = (int)0x80000000, LEAVE = END + 1;
constexpr long long NODE = NODE_BYTES, GROUP = GROUP_BYTES;
#if TREELETS
constexpr int PATH_FIRST = 8;
constexpr bool KEEPS_TRAIL = TASK != TREELET;  // rays must know which way through the top level they took
#endif
// Where a ray is against boxes, by axis (the fourth is unused). A plane at p is met at fma(p, inverse, near) at the
// earliest and fma(p, inverse, far) at the latest; `row` has the byte in a node where the near planes are, the far ones
// are at row ^ 32.
struct alignas(64) Slabs {
    FourFloats inverse, near, far;
    FourInts row;
};
struct RayState {
    Slabs slabs;
    float best;  // distance of the closest hit so far, or t_max
    int child;   // what the ray visits next: a node, or a leaf's code below 0; `at` is its address
    const char* at;
    long long top;  // first free entry of the stack
    // triangle test: axes x, y, z as `intersect.py` permutes them
    float ox, oy, oz, sx, sy, sz;
    int x, y, z;     // bytes from corner to coordinate in a group
    int slot, face;  // ray slot; triangle of the closest hit so far, -1: none
    float v, w;      // weights of its second and third corner
    // instancing
    int entry, hit_entry;  // the tree that the ray is in (-1: the top level); that of the closest hit so far
    const char *nodes, *triangles;
    Slabs top_slabs;
#if MOTION
    BetweenSteps between;  // in bytes
#endif
#if TREELETS
    bool any;                       // asks whether anything is hit
    int index;                      // in the list
    int face_before, entry_before;  // the closest hit as it was read; no triangle has the number -2
    // A trail code is level * 8 + child slot in the resident node that holds a child, levels from the root on; -8 is
    // the root's
    int trail_code;                        // of the child taken last
    int treelet, treelet_trail_code;       // that the ray is in
    unsigned char path[PATH_FIRST + 192];  // child slot taken at each level, from PATH_FIRST on; the root's is before
    alignas(64) int trail_codes[KEEPS_TRAIL ? STACK : 16];  // of waiting children
#endif
#if COUNTERS
    int node_steps, box_tests, triangle_tests;
#if TREELETS
    int entered;
    bool counts_begin;
#endif
#endif
    alignas(64) float distance[STACK];  // at which waiting children are entered, rounded down; NaN at the ends
    alignas(64) int waiting[STACK];
};
// Rays are 128 bytes more than a multiple of 4096 apart, else they would share sets of the cache
struct Ray : RayState {
    char apart[4096 - (sizeof(RayState) - 128) % 4096];
};
const char* const NODES = (const char*)tree.nodes.data;
const char* const TRIANGLES = (const char*)tree.triangles.data;
const bool empty = tree.entry_count <= 0;
// of the only tree, if there is no top level
const char* const ONLY_NODES = TWO_LEVEL || empty ? NODES : NODES + NODE * tree.entry_node.data[0];
const char* const ONLY_TRIANGLES = TWO_LEVEL || empty ? TRIANGLES : TRIANGLES + GROUP * tree.entry_triangle.data[0];

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
auto four = [](const float* a) INLINE -> FourFloats { return FourFloats{a[0], a[1], a[2], 0.0f}; };
// Whether the ray can be traced. If not (it is not finite, or 0) planes could be NaN, and empty child slots be met.
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
    ray.sx = shear[0];
    ray.sy = shear[1];
    ray.sz = shear[2];
    ray.ox = o[x];
    ray.oy = o[y];
    ray.oz = o[z];
    ray.x = 32 * x;
    ray.y = 32 * y;
    ray.z = 32 * z;
};
#if MOTION
// In blocks of which each step has `stride` groups
auto set_between = [&](Ray& ray, int stride)
                       INLINE { ray.between = between_steps((long long)stride * GROUP, time_of(ray.slot)); };
#endif
// Into the tree of an entry, with the ray in its space; whether it can be traced
auto set_entry = [&](Ray& ray, int entry) INLINE -> bool {
    const auto& p = rays.origin.data[ray.slot];
    const auto& v = rays.direction.data[ray.slot];
    // coordinate by coordinate: a copied vector is stored in other pieces than it is read in, which takes a while
    float o[3] = {p[0], p[1], p[2]}, d[3] = {v[0], v[1], v[2]};
    if (TWO_LEVEL) {
#if MOTION
        const auto from_world = from_world_at(entry, time_of(ray.slot));
        set_between(ray, tree.entry_deform.data[entry]);
#else
        const auto& from_world = tree.entry_from_world.data[entry];
#endif
        const auto moved = transformed_point(from_world, p), turned = transformed_vector(from_world, v);
        for (int k = 0; k < 3; ++k) {
            o[k] = moved[k];
            d[k] = turned[k];
        }
        ray.entry = entry;
        ray.nodes = NODES + NODE * tree.entry_node.data[entry];
        ray.triangles = TRIANGLES + GROUP * tree.entry_triangle.data[entry];
    }
    ray.child = 0;
    ray.at = TWO_LEVEL ? ray.nodes : ONLY_NODES;
    set_shear(ray, o, d);
    return set_slabs(ray.slabs, four(o), four(d), four(tree.entry_centre.data[entry].c), SLAB_MARGIN);
};
auto to_top = [&](Ray& ray) INLINE {
    ray.slabs = ray.top_slabs;
    ray.entry = -1;
    ray.nodes = NODES + NODE * top_node_of(ray.slot);
    ray.triangles = NODES;  // never read, but asked for ahead
};
// At the root of the top level; whether the ray can be traced
auto set_top = [&](Ray& ray) INLINE -> bool {
    const FourFloats o = four(rays.origin.data[ray.slot].c), d = four(rays.direction.data[ray.slot].c);
    const bool sound = set_slabs(ray.top_slabs, o, d, four(top_centre_of(ray.slot).c), tree.top_margin);
    to_top(ray);
    ray.at = ray.nodes;
    ray.child = 0;
    return sound;
};
