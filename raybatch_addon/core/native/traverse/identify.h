// Which instance a triangle of a tree belongs to.

#if defined(__CUDA_ARCH__)
#define UNPREDICTABLE(condition) (condition)
#else
#define UNPREDICTABLE(condition) __builtin_unpredictable(condition)
#endif
// Instance and primitive of triangle `face` of the entry `e`
auto identify = [&](int e, int face, int& instance, int& primitive) {
    instance = tree.entry_instance.data[e];
    primitive = face;
    if (instance >= 0) return;
    // the last baked instance whose first triangle is not beyond `face`; a branch would often be predicted wrongly
    int low = tree.merged_first.data[e];
    for (int count = tree.merged_first.data[e + 1] - low; count > 1; count -= count >> 1) {
        const int middle = low + (count >> 1);
        low = UNPREDICTABLE(tree.merged_triangle_first.data[middle] <= face) ? middle : low;
    }
    instance = tree.merged_instance.data[low];
    primitive = face - tree.merged_triangle_first.data[low];
};
