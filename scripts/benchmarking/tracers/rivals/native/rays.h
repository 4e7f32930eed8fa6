// Rays of a stream or packet in trees of the layout BOXES: two cache lines each, the first of which boxes are met with.

constexpr long long NODE = NODE_BYTES, GROUP = GROUP_BYTES;
typedef unsigned short Id;  // of a ray in its stream
struct alignas(64) Ray {
    // A plane at p is met at fma(p, inverse, near) at the earliest and fma(p, inverse, far) at the latest; `row` has the
    // byte in a node where the near planes are, the far ones are at row ^ 32
    float inverse[3], best;  // `best`: distance of the closest hit so far, or t_max; -1 when any hit was asked and found
    float near[3];
    int slot;
    float far[3];
    int entry;  // the tree that the ray is in
    int row[3];
    int face;  // of the closest hit so far, -1: none
    // triangle test
    float ox, oy, oz, sx, sy, sz;
    short x, y, z, top;
    const char* at;
    float v, w;
    int hit_entry;  // the tree of the closest hit so far
    int child;
    int index;   // of an instance's ray: which ray of the top level it is
    int octant;  // bit k: the direction is negative along axis k
};
static_assert(sizeof(Ray) == 128, "two cache lines");
const char* const NODES = (const char*)tree.nodes.data;
const char* const TRIANGLES = (const char*)tree.triangles.data;
long long nodes_read = 0, steps = 0;  // nodes that were visited, and rays that met them

auto ask_for = [&](const char* p) INLINE {
    __builtin_prefetch(p);
    __builtin_prefetch(p + 64);
    __builtin_prefetch(p + 128);
    __builtin_prefetch(p + 192);
    __builtin_prefetch(p + 256);
};
auto children_at = [&](const char* node) INLINE -> const int* { return (const int*)(node + NODE_CHILD); };
auto nodes_of = [&](int entry) INLINE -> const char* { return NODES + NODE * tree.entry_node.data[entry]; };
auto triangles_of = [&](int entry) INLINE -> const char* { return TRIANGLES + GROUP * tree.entry_triangle.data[entry]; };
auto address = [&](int child, const char* nodes, const char* triangles) INLINE -> const char* {
    return child < 0 ? triangles + GROUP * ((unsigned)~child >> 3) : nodes + NODE * child;
};
// Whether the ray (o, d) can be traced, relative to `centre`; the arithmetic is that of the engine's own rays, so that
// their margins hold
auto set_slabs = [&](Ray& ray, const float* o, const float* d, const float* centre, float margin) INLINE -> bool {
    float size[3], c[3], largest = 0.0f, reach = 0.0f;
    for (int k = 0; k < 3; ++k) {
        c[k] = o[k] - centre[k];
        size[k] = __builtin_fabsf(d[k]);
        largest = size[k] > largest ? size[k] : largest;
        reach = __builtin_fabsf(c[k]) > reach ? __builtin_fabsf(c[k]) : reach;
    }
    const float least = largest * DIRECTION_LEAST;
    float finite = 0.0f;
    ray.octant = 0;
    for (int k = 0; k < 3; ++k) {
        const float raised = __builtin_copysignf(size[k] > least ? size[k] : least, d[k]), inverse = 1.0f / raised;
        const float back = __builtin_copysignf(reach * margin, raised);
        const int negative = __builtin_signbit(raised) != 0;
        ray.inverse[k] = inverse;
        ray.near[k] = -(c[k] + back) * inverse;
        ray.far[k] = -(c[k] - back) * inverse;
        ray.row[k] = 64 * k + 32 * negative;
        ray.octant |= negative << k;
        finite += __builtin_fabsf(inverse) + __builtin_fabsf(ray.near[k]) + __builtin_fabsf(ray.far[k]);
    }
    // a coordinate that is no number makes the sum one that is none
    return finite < __builtin_inff() && size[0] + size[1] + size[2] < __builtin_inff();
};
auto set_shear = [&](Ray& ray, const float* o, const float* d) INLINE {
    const float ax = __builtin_fabsf(d[0]), ay = __builtin_fabsf(d[1]), az = __builtin_fabsf(d[2]);
    const int z = az > (ay > ax ? ay : ax) ? 2 : ay > ax ? 1 : 0, x = z == 2 ? 0 : z + 1, y = z == 0 ? 2 : z - 1;
    ray.sx = d[x] / d[z];
    ray.sy = d[y] / d[z];
    ray.sz = 1.0f / d[z];
    ray.ox = o[x];
    ray.oy = o[y];
    ray.oz = o[z];
    ray.x = (short)(32 * x);
    ray.y = (short)(32 * y);
    ray.z = (short)(32 * z);
};
// The node at `p`: which children the ray meets, and the distances at which it enters them
auto meet = [&](const Ray& ray, const char* p, Floats& enter) INLINE -> unsigned {
    auto planes = [&](int row) INLINE -> Floats { return *(const Floats*)(p + row); };
    const Floats ix = all(ray.inverse[0]), iy = all(ray.inverse[1]), iz = all(ray.inverse[2]);
    const Floats x0 = fused(planes(ray.row[0]), ix, all(ray.near[0]));
    const Floats y0 = fused(planes(ray.row[1]), iy, all(ray.near[1]));
    const Floats z0 = fused(planes(ray.row[2]), iz, all(ray.near[2]));
    const Floats x1 = fused(planes(ray.row[0] ^ 32), ix, all(ray.far[0]));
    const Floats y1 = fused(planes(ray.row[1] ^ 32), iy, all(ray.far[1]));
    const Floats z1 = fused(planes(ray.row[2] ^ 32), iz, all(ray.far[2]));
    enter = larger(larger(x0, y0), larger(z0, all(0.0f)));
    return at_most(enter, smaller(smaller(x1, y1), smaller(z1, all(ray.best))));
};
// The children of `met`, the farthest first: in each key the lowest three bits are the child, the others the distance
auto by_distance = [&](Floats enter, unsigned met) INLINE -> Ints {
    const Ints key = compressed(((Ints)enter & ~7) | Ints{0, 1, 2, 3, 4, 5, 6, 7}, met);
    return __builtin_popcount(met) <= 4 ? sorted_four(key) : sorted_eight(key);
};
