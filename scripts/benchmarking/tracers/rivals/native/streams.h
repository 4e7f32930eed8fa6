// The loop over streams: rays of the list, `size` after another, go through the tree together. `traverse` takes them
// through one tree, and hands the rays that come to a leaf to `leaf(ids, count, code)`.

const int size = scratch.size;
char* const memory = (char*)(((unsigned long long)scratch.memory.data + 63ull) & ~63ull);
Ray* const stream = (Ray*)memory;
Ray* const inside = stream + size;  // rays of one instance
char* const lists = (char*)(inside + size);
for (int from = first; from < end; from += size) {
    const int until = end - from < size ? end : from + size;
    int count = 0;
    for (int i = from; i < until; ++i) count += begin(stream[count], listed.slots.data[i]);
    if (count == 0) continue;
#if TWO_LEVEL
    const char* const top_nodes = NODES + NODE * tree.top_node;
    auto enter_leaf = [&](const Id* ids, int n, int code) {
        for (int e = (unsigned)~code >> 3, last = e + (~code & 7); e <= last; ++e) {
            const int entry = tree.top_entry.data[e];
            const int entered = enter_entry(stream, ids, n, entry, inside);
            if (entered == 0) continue;
            const char* const triangles = triangles_of(entry);
            auto test_inside = [&](const Id* those, int m, int leaf_code)
                                   INLINE { test_rays(inside, those, m, leaf_code, triangles); };
            traverse(inside, entered, nodes_of(entry), triangles, lists + scratch.tree_bytes, test_inside);
            leave_entry(inside, entered, stream);
        }
    };
    traverse(stream, count, top_nodes, top_nodes, lists, enter_leaf);
#else
    const char* const triangles = triangles_of(0);
    auto test_leaf_of = [&](const Id* ids, int n, int code) INLINE { test_rays(stream, ids, n, code, triangles); };
    traverse(stream, count, nodes_of(0), triangles, lists, test_leaf_of);
#endif
    for (int i = 0; i < count; ++i) finish(stream[i]);
}
scratch.totals.data[0] += nodes_read;
scratch.totals.data[1] += steps;
