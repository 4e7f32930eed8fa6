// A step of a ray in trees of the layout BOXES: it meets the children of a node, and takes one from its stack.

auto ask_for = [](const char* p) INLINE {
    __builtin_prefetch(p);
    __builtin_prefetch(p + 64);
    __builtin_prefetch(p + 128);
    __builtin_prefetch(p + 192);
    __builtin_prefetch(p + 256);
};
// Trees that are cut into treelets mark nodes that are roots of treelets, and have the blocks of many meshes
#if TREELETS
auto nodes_of = [](const Ray& ray) INLINE -> const char* { return ray.nodes; };
auto triangles_of = [](const Ray& ray) INLINE -> const char* { return ray.triangles; };
auto node_of = [](int child) INLINE -> int { return child & (KEEPS_TRAIL ? ~TREELET_CHILD : -1); };
#else
auto nodes_of = [&](const Ray& ray) INLINE -> const char* { return TWO_LEVEL ? ray.nodes : ONLY_NODES; };
auto triangles_of = [&](const Ray& ray) INLINE -> const char* { return TWO_LEVEL ? ray.triangles : ONLY_TRIANGLES; };
auto node_of = [](int child) INLINE -> int { return child; };
#endif
// Address of a child. Nodes and leaves come in no order that a processor could guess: no branch.
auto address = [&](const Ray& ray, int child) INLINE -> const char* {
    const char* node = nodes_of(ray) + NODE * node_of(child);
    const char* group = triangles_of(ray) + GROUP * ((unsigned)~child >> 3);
    long long leaf = (long long)child >> 63;
    __asm__("" : "+r"(leaf));  // else the compiler finds a branch here
    return (const char*)(((long long)node & ~leaf) | ((long long)group & leaf));
};
auto children_at = [](const char* node) INLINE -> const int* { return (const int*)(node + NODE_CHILD); };
// The node at `p`: which children the ray meets, and the distances at which it enters them
auto meet = [&](Ray& ray, const char* p, Floats& enter) INLINE -> unsigned {
    const Slabs& s = ray.slabs;
    const Floats ix = all(s.inverse[0]), iy = all(s.inverse[1]), iz = all(s.inverse[2]);
    auto planes = [&](int row) INLINE -> Floats { return *(const Floats*)(p + row); };
    const Floats x0 = fused(planes(s.row[0]), ix, all(s.near[0])), x1 = fused(planes(s.row[0] ^ 32), ix, all(s.far[0]));
    const Floats y0 = fused(planes(s.row[1]), iy, all(s.near[1])), y1 = fused(planes(s.row[1] ^ 32), iy, all(s.far[1]));
    const Floats z0 = fused(planes(s.row[2]), iz, all(s.near[2])), z1 = fused(planes(s.row[2] ^ 32), iz, all(s.far[2]));
    enter = larger(larger(x0, y0), larger(z0, all(0.0f)));
#if COUNTERS
    ++ray.node_steps;
    ray.box_tests += 8 - __builtin_popcount(negative(*(const Ints*)children_at(p) == all_ints(EMPTY_CHILD)));
#endif
    return at_most(enter, smaller(smaller(x1, y1), smaller(z1, all(ray.best))));
};
// These children go on the stack, the nearest on top; how many
auto put_off = [&](Ray& ray, const char* p, Floats enter, unsigned met) INLINE -> int {
    // distances are not below 0, so that their bits are in order; the last three make room for the child slot
    Ints key = compressed(((Ints)enter & ~7) | Ints{0, 1, 2, 3, 4, 5, 6, 7}, met);
    const int count = __builtin_popcount(met);
    key = __builtin_expect(count <= 4, 1) ? sorted_four(key) : sorted_eight(key);
    *(LooseInts*)(ray.waiting + ray.top) = picked(*(const Ints*)children_at(p), key & 7);
    *(LooseInts*)(ray.distance + ray.top) = key & ~7;
#if TREELETS
    if (KEEPS_TRAIL) *(LooseInts*)(ray.trail_codes + ray.top) = (key & 7) + all_ints((ray.trail_code & ~7) + 8);
#endif
    return count;
};
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
    for (int k = 0; k < 8; ++k) {
        ray.waiting[k] = END;
        ray.distance[k] = __builtin_nanf("");
    }
};
