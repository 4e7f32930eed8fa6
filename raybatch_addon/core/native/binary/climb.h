// Boxes and heights of inner nodes, from one leaf up: of two threads that meet in a node the second goes on, when both
// children have their boxes.
#if defined(__CUDA_ARCH__)
// what other threads wrote is in the second-level cache, not in this one's first
auto load = [](const float* p) { return __ldcg(p); };
auto load_int = [](const int* p) { return __ldcg(p); };
auto arrive = [](int* p) {
    __threadfence();
    const int before = atomicAdd(p, 1);
    __threadfence();
    return before;
};
#else
auto load = [](const float* p) { return *p; };
auto load_int = [](const int* p) { return *p; };
auto arrive = [](int* p) { return (*p)++; };
#endif
const int first = nodes.leaf_count;
for (int node = links.parent.data[leaf]; node >= 0; node = links.parent.data[node]) {
    const int k = node - first;
    if (arrive(links.arrived.data + k) == 0) return;
    const int a = nodes.children.data[k][0], b = nodes.children.data[k][1];
    const float *low_a = (const float*)(nodes.low.data + a), *low_b = (const float*)(nodes.low.data + b);
    const float *high_a = (const float*)(nodes.high.data + a), *high_b = (const float*)(nodes.high.data + b);
    float *low = (float*)(nodes.low.data + node), *high = (float*)(nodes.high.data + node);
    for (int axis = 0; axis < 3; ++axis) {
        const float l = load(low_a + axis), m = load(low_b + axis);
        low[axis] = l < m ? l : m;
        const float h = load(high_a + axis), i = load(high_b + axis);
        high[axis] = h > i ? h : i;
    }
    const int height_a = a < first ? 0 : load_int(links.height.data + a - first);
    const int height_b = b < first ? 0 : load_int(links.height.data + b - first);
    links.height.data[k] = 1 + (height_a > height_b ? height_a : height_b);
}
