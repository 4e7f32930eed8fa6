// A ray that is left alone goes through the rest of a subtree with a stack of its own.

auto alone = [&](Ray* set, Id id, int child, const char* nodes, const char* triangles, auto&& leaf) {
    Ray& ray = set[id];
    alignas(64) int waiting[STACK];
    alignas(64) float distance[STACK];
    for (int top = 0;;) {
        if (child >= 0) {
            const char* p = nodes + NODE * child;
            Floats enter;
            const unsigned met = meet(ray, p, enter);
            ++nodes_read;
            ++steps;
            if (met != 0u) {
                const int* children = children_at(p);
                for (unsigned rest = met; rest; rest &= rest - 1u)
                    ask_for(address(children[__builtin_ctz(rest)], nodes, triangles));
                const Ints key = by_distance(enter, met);
                *(LooseInts*)(waiting + top) = picked(*(const Ints*)children, key & 7);
                *(LooseInts*)(distance + top) = key & ~7;
                top += __builtin_popcount(met) - 1;
                child = waiting[top];
                continue;
            }
        } else {
            leaf(&id, 1, child);
        }
        do {
            if (top == 0) return;
            --top;
        } while (distance[top] > ray.best);
        child = waiting[top];
    }
};
