// Ranged traversal: a node is visited by the rays from the first one on that meets its box.

struct Task {
    const char* parent;
    int place, child;  // slot in the parent, and what is there
    int first;
    float enter;  // distance at which that ray enters it
};
auto traverse = [&](Ray* set, int count, const char* nodes, const char* triangles, char* room, auto&& leaf) {
    Packet packet;
    packet.rays = set;
    packet.blocks = (Block*)room;
    assemble(packet, count);
    Id* const ids = (Id*)(packet.blocks + packet.block_count);
    Task tasks[8 * LEVELS];
    int top = 0, child = 0, first = 0;
    float limit = limit_of(packet);
    // the first ray from `i` on that meets a child, and whether there is one
    auto next_ray = [&](const char* p, int k, int& i) INLINE -> bool {
        unsigned behind = 0xffu << (i & 7);
        for (int b = i >> 3; b < packet.block_count; ++b, behind = 0xffu) {
            const unsigned met = meet_child(packet.blocks[b], p, k) & behind;
            if (met) {
                i = 8 * b + __builtin_ctz(met);
                return true;
            }
        }
        return false;
    };
    for (;;) {
        const char* const p = nodes + NODE * child;
        const int* const children = children_at(p);
        int firsts[8];
        Floats enter;
        unsigned met = meet(set[first], p, enter);
        ++nodes_read;
        ++steps;
        for (int k = 0; k < 8; ++k) firsts[k] = first;
        const unsigned some = met == 0xffu ? 0u : meet_together(packet, p, limit) & ~met;
        for (unsigned rest = some; rest; rest &= rest - 1u) {
            const int k = __builtin_ctz(rest);
            int i = first + 1;
            if (!next_ray(p, k, i)) continue;
            firsts[k] = i;
            met |= 1u << k;
            Floats its;
            meet(set[i], p, its);
            ((float*)&enter)[k] = ((const float*)&its)[k];
            ++steps;
        }
        const Ints key = by_distance(enter, met);
        for (int i = 0; i < __builtin_popcount(met); ++i) {
            const int k = ((const int*)&key)[i] & 7;
            tasks[top++] = Task{p, k, children[k], firsts[k], ((const float*)&enter)[k]};
        }
        // leaves up to the next node
        for (child = -1; child < 0;) {
            if (top == 0) return;
            Task& task = tasks[--top];
            if (top > 0) ask_for(address(tasks[top - 1].child, nodes, triangles));
            first = task.first;
            if (task.enter > set[first].best && !next_ray(task.parent, task.place, ++first)) continue;
            child = task.child;
            if (child >= 0) break;
            int n = 0;
            for (int b = first >> 3; b < packet.block_count; ++b)
                for (unsigned hit = meet_child(packet.blocks[b], task.parent, task.place); hit; hit &= hit - 1u)
                    ids[n++] = (Id)(8 * b + __builtin_ctz(hit));
            leaf(ids, n, child);
            note_hits(packet, ids, n);
            limit = limit_of(packet);
        }
    }
};
