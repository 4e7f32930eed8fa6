// Multi-BVH ray stream tracing: a stream is filtered into one list a child, and all its rays take the children in one
// order.

struct Task {
    const Id* ids;
    Id* free;  // where lists of nodes below may lie
    int count, child;
};
auto traverse = [&](Ray* set, int count, const char* nodes, const char* triangles, char* room, auto&& leaf) {
    Task tasks[8 * LEVELS];
    Id* const root = (Id*)room;
    for (int i = 0; i < count; ++i) root[i] = (Id)i;
    tasks[0] = Task{root, root + count, count, 0};
    for (int top = 1; top > 0;) {
        const Task task = tasks[--top];
        if (top > 0) ask_for(address(tasks[top - 1].child, nodes, triangles));
        if (task.child < 0) {
            leaf(task.ids, task.count, task.child);
            continue;
        }
        const char* const p = nodes + NODE * task.child;
        const int* const children = children_at(p);
        const int stride = task.count + 37;  // lists begin in other sets of the cache
        int counts[8] = {};
        Floats sum = all(0.0f);
        ++nodes_read;
        steps += task.count;
        for (int i = 0; i < task.count; ++i) {
            const Id id = task.ids[i];
            Floats enter;
            const unsigned met = meet(set[id], p, enter);
            sum += (all_ints((int)met) & Ints{1, 2, 4, 8, 16, 32, 64, 128}) != 0 ? enter : all(0.0f);
            // every list gets the ray at its end, but only the ends of those that want it move on
            for (int k = 0; k < 8; ++k) {
                task.free[k * stride + counts[k]] = id;
                counts[k] += met >> k & 1;
            }
        }
        unsigned some = 0;
        Floats mean;
        for (int k = 0; k < 8; ++k) {
            some |= (counts[k] != 0 ? 1u : 0u) << k;
            ((float*)&mean)[k] = ((const float*)&sum)[k] / (float)(counts[k] | (counts[k] == 0));
        }
        const Ints key = by_distance(mean, some);
        for (int i = 0; i < __builtin_popcount(some); ++i) {
            const int k = ((const int*)&key)[i] & 7;
            tasks[top++] = Task{task.free + k * stride, task.free + 8 * stride, counts[k], children[k]};
        }
    }
};
