// The plan of a tree of BOXES: nodes are numbered depth-first.
stack[open++] = {0, 1, -1, 0};  // node and slot that hold it
while (open) {
    const Wide w = stack[--open];
    int child[8];
    const int count = children_of(w.binary, child);
    int* P = work.plan.data + 16ll * node_count;
    if (8ll * listed > 0x7fffff00ll * work.unit) return TOO_MANY_LISTED;
    if (w.node >= 0) work.plan.data[16ll * w.node + 8 + w.slot] = node_count;
    levels = w.level > levels ? w.level : levels;
    sah += chance_of(w.binary) * work.node_cost;
    for (int s = 0; s < 8; ++s) {
        P[s] = s < count ? child[s] : -1;
        P[8 + s] = EMPTY_CHILD;
        if (s < count && D[8ll * child[s]]) {
            const int first = listed / work.unit;
            list_leaf(child[s]);
            P[8 + s] = ~(first * 8 + (listed / work.unit - first - 1));
        }
    }
    for (int s = count - 1; s >= 0; --s)
        if (!D[8ll * child[s]]) {
            if (open == STACK) return TOO_DEEP;
            stack[open++] = {child[s], w.level + 1, node_count, s};
        }
    ++node_count;
}
