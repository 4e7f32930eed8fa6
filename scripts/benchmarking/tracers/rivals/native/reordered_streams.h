// Dynamic ray stream traversal: a node makes streams of the rays that want the same child at the same place of their
// order, and takes them one after another.
//
// The eight children are halves of halves. Two halves A and B make the streams A B A: rays that want A first are in the
// first two, rays that want B first in the last two. So the children make 27 streams, in which a ray keeps its order.

struct Waiting {
    int id;
    float enter;  // into the box of the child
};
struct Task {
    const Waiting* rays;
    Waiting* free;  // where streams of nodes below may lie
    int count, child;
};
auto traverse = [&](Ray* set, int count, const char* nodes, const char* triangles, char* room, auto&& leaf) {
    Task tasks[27 * LEVELS];
    Id* const ids = (Id*)room;
    Waiting* const root = (Waiting*)(room + ((2ll * scratch.size + 63) & ~63ll));
    for (int i = 0; i < count; ++i) root[i] = Waiting{i, 0.0f};
    tasks[0] = Task{root, root + count, count, 0};
    for (int top = 1; top > 0;) {
        const Task task = tasks[--top];
        if (top > 0) ask_for(address(tasks[top - 1].child, nodes, triangles));
        // those that found something nearer since are left out
        if (task.child < 0) {
            int n = 0;
            for (int i = 0; i < task.count; ++i) {
                ids[n] = (Id)task.rays[i].id;
                n += task.rays[i].enter <= set[task.rays[i].id].best;
            }
            if (n) leaf(ids, n, task.child);
            continue;
        }
        if (task.count <= scratch.alone) {
            for (int i = 0; i < task.count; ++i)
                if (task.rays[i].enter <= set[task.rays[i].id].best)
                    alone(set, (Id)task.rays[i].id, task.child, nodes, triangles, leaf);
            continue;
        }
        const char* const p = nodes + NODE * task.child;
        const int* const children = children_at(p);
        const int stride = task.count + 9;  // streams begin in other sets of the cache
        int counts[27] = {};
        ++nodes_read;
        for (int i = 0; i < task.count; ++i) {
            const int id = task.rays[i].id;
            const Ray& ray = set[id];
            if (task.rays[i].enter > ray.best) continue;
            ++steps;
            Floats enter;
            const unsigned met = meet(ray, p, enter);
            const Floats one = (all_ints((int)met) & Ints{1, 2, 4, 8, 16, 32, 64, 128}) != 0 ? enter
                                                                                           : all(__builtin_inff());
            // in which of two neighbours, pairs, halves a ray comes later
            const Floats other = __builtin_shufflevector(one, one, 1, 0, 3, 2, 5, 4, 7, 6);
            const Floats pair = smaller(one, other);
            const Floats other_pair = __builtin_shufflevector(pair, pair, 2, 3, 0, 1, 6, 7, 4, 5);
            const Floats half = smaller(pair, other_pair);
            const Floats other_half = __builtin_shufflevector(half, half, 4, 5, 6, 7, 0, 1, 2, 3);
            const Ints number = Ints{0, 1, 3, 4, 9, 10, 12, 13} + ((one > other) & Ints{2, 0, 2, 0, 2, 0, 2, 0}) +
                                ((pair > other_pair) & Ints{6, 6, 0, 0, 6, 6, 0, 0}) +
                                ((half > other_half) & Ints{18, 18, 18, 18, 0, 0, 0, 0});
            for (unsigned rest = met; rest; rest &= rest - 1u) {
                const int k = __builtin_ctz(rest), s = ((const int*)&number)[k];
                task.free[(long long)s * stride + counts[s]++] = Waiting{id, ((const float*)&enter)[k]};
            }
        }
        for (int s = 26; s >= 0; --s) {
            if (counts[s] == 0) continue;
            const int k = 4 * (s / 9 == 1) + 2 * (s / 3 % 3 == 1) + (s % 3 == 1);
            tasks[top++] = Task{task.free + (long long)s * stride, task.free + 27ll * stride, counts[s], children[k]};
        }
    }
};
