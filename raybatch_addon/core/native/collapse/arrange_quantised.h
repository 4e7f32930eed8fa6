// The plan of a tree of QUANTISED: inner children of a node are contiguous, in the order of slots.
stack[open++] = {0, 1, 0, 0};  // its own node
node_count = 1;
while (open) {
    const Wide w = stack[--open];
    int child[8];
    const int count = children_of(w.binary, child);
    int* P = work.plan.data + 16ll * w.node;
    levels = w.level > levels ? w.level : levels;
    sah += chance_of(w.binary) * work.node_cost;
    // Slots by octant (section 3.2 of the paper): a child is the better placed the farther it lies towards the slot's
    // corner of the node. The best pair of child and free slot is taken first.
    float offset[8][3];
    for (int c = 0; c < count; ++c)
        for (int k = 0; k < 3; ++k)
            offset[c][k] =
                0.5f * (N[child[c]].low[k] - N[w.binary].low[k]) + 0.5f * (N[child[c]].high[k] - N[w.binary].high[k]);
    float gain[8][8];
    for (int c = 0; c < count; ++c)
        for (int s = 0; s < 8; ++s)
            gain[c][s] = (s & 4 ? offset[c][0] : -offset[c][0]) + (s & 2 ? offset[c][1] : -offset[c][1]) +
                         (s & 1 ? offset[c][2] : -offset[c][2]);
    for (int s = 0; s < 8; ++s) P[s] = -1;
    bool placed[8] = {};
    for (int round = 0; round < count; ++round) {
        int best_c = -1, best_s = -1;
        for (int c = 0; c < count; ++c)
            for (int s = 0; s < 8; ++s)
                if (!placed[c] && P[s] < 0 && (best_c < 0 || gain[c][s] > gain[best_c][best_s])) {
                    best_c = c;
                    best_s = s;
                }
        placed[best_c] = true;
        P[best_s] = child[best_c];
    }
    unsigned char* meta = (unsigned char*)(P + 10);
    int mask = 0, inner = 0;
    P[8] = node_count;
    P[9] = listed;
    for (int s = 0; s < 8; ++s) {
        meta[s] = 0;
        if (P[s] < 0) continue;
        if (D[8ll * P[s]]) {
            const int offset = listed - P[9];
            meta[s] = (unsigned char)(((1 << list_leaf(P[s])) - 1) << 5 | offset);
        } else {
            meta[s] = (unsigned char)(1 << 5 | (24 + s));
            mask |= 1 << s;
            ++inner;
        }
    }
    P[12] = mask;
    if (open + inner > STACK) return TOO_DEEP;
    node_count += inner;
    for (int s = 7, i = node_count; s >= 0; --s)
        if (mask >> s & 1) stack[open++] = {P[s], w.level + 1, --i, s};
}
