// The next item after `before`, the number of one or -1, whose box the ray from `origin` with the reciprocal `inverse`
// of its direction enters before `t_max`; -1: there is none. Items are numbered as the tree is gone through.
auto entered = [&](const auto& block) -> unsigned {
#if defined(__CUDA_ARCH__)
    unsigned found = 0u;
#pragma unroll 1
    for (int k = 0; k < WIDTH && block.last[k] >= 0; ++k) {
        const float x0 = (block.low_x[k] - origin[0]) * inverse[0], x1 = (block.high_x[k] - origin[0]) * inverse[0];
        const float y0 = (block.low_y[k] - origin[1]) * inverse[1], y1 = (block.high_y[k] - origin[1]) * inverse[1];
        const float z0 = (block.low_z[k] - origin[2]) * inverse[2], z1 = (block.high_z[k] - origin[2]) * inverse[2];
        const float first = wp::max(wp::max(wp::min(x0, x1), wp::min(y0, y1)), wp::max(wp::min(z0, z1), 0.0f));
        const float end = wp::min(wp::min(wp::max(x0, x1), wp::max(y0, y1)), wp::max(z0, z1));
        if (block.last[k] > before && first <= end && first < t_max) found |= 1u << k;
    }
    return found;
#else
    typedef float Wide __attribute__((ext_vector_type(WIDTH)));
    typedef int Counts __attribute__((ext_vector_type(WIDTH)));
    typedef bool Flags __attribute__((ext_vector_type(WIDTH)));
    auto slab = [&](const auto& side, int axis) {
        Wide place;
        __builtin_memcpy(&place, &side, sizeof(place));
        return (place - origin[axis]) * inverse[axis];
    };
    auto least = [](Wide a, Wide b) { return __builtin_elementwise_min(a, b); };
    auto most = [](Wide a, Wide b) { return __builtin_elementwise_max(a, b); };
    const Wide x0 = slab(block.low_x, 0), x1 = slab(block.high_x, 0), y0 = slab(block.low_y, 1),
               y1 = slab(block.high_y, 1), z0 = slab(block.low_z, 2), z1 = slab(block.high_z, 2);
    const Wide first = most(most(least(x0, x1), least(y0, y1)), most(least(z0, z1), (Wide)(0.0f)));
    const Wide end = least(least(most(x0, x1), most(y0, y1)), most(z0, z1));
    Counts last;
    __builtin_memcpy(&last, &block.last, sizeof(last));
    const Flags flags = __builtin_convertvector((last > before) & (first <= end) & (first < t_max), Flags);
    unsigned short found;
    static_assert(sizeof(flags) == sizeof(found), "a bit for each of WIDTH");
    __builtin_memcpy(&found, &flags, sizeof(found));
    return found;
#endif
};
int above[LEVELS];  // blocks that the ray is in, and which of their children are still to be looked at
unsigned pending[LEVELS];
int level = 0;
above[0] = 0;
pending[0] = entered(tree.data[0]);
while (level >= 0) {
    if (pending[level] == 0u) {
        --level;
        continue;
    }
    int k = 0;
#if defined(__CUDA_ARCH__)
    k = __ffs(pending[level]) - 1;
#else
    k = __builtin_ctz(pending[level]);
#endif
    pending[level] &= pending[level] - 1u;
    const auto& block = tree.data[above[level]];
    if (block.below[k] < 0) return block.last[k];
    above[++level] = block.below[k];
    pending[level] = entered(tree.data[above[level]]);
}
return -1;
