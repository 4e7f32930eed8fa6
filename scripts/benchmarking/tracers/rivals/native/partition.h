// Partition traversal: the blocks of eight rays that meet a box come to the front of the list, and visit what is in it.

struct Task {
    const char* parent;
    int place, child;  // slot in the parent, and what is there
    int count;         // blocks at the front of the list that met the parent
};
auto traverse = [&](Ray* set, int count, const char* nodes, const char* triangles, char* room, auto&& leaf) {
    Packet packet;
    packet.rays = set;
    packet.blocks = (Block*)room;
    assemble(packet, count);
    Id* const ids = (Id*)(packet.blocks + packet.block_count);
    Id* const order = ids + packet.block_count * 8;
    unsigned char* const met = (unsigned char*)(order + packet.block_count);  // rays of each block at the front
    for (int b = 0; b < packet.block_count; ++b) order[b] = (Id)b;
    Task tasks[8 * LEVELS];
    int top = 0, child = 0, active = packet.block_count;
    float limit = limit_of(packet);
    for (;;) {
        const char* const p = nodes + NODE * child;
        const int* const children = children_at(p);
        const unsigned some = meet_together(packet, p, limit);
        if (some) {
            Floats enter;  // a ray that misses a box says where it lies, too
            const int b = order[0], last = packet.count - 1;
            meet(set[8 * b < last ? 8 * b : last], p, enter);
            const Ints key = by_distance(enter, some);
            for (int i = 0; i < __builtin_popcount(some); ++i) {
                const int k = ((const int*)&key)[i] & 7;
                tasks[top++] = Task{p, k, children[k], active};
            }
        }
        ++nodes_read;
        ++steps;
        for (child = -1; child < 0;) {
            if (top == 0) return;
            const Task task = tasks[--top];
            if (top > 0) ask_for(address(tasks[top - 1].child, nodes, triangles));
            active = 0;
            steps += task.count;
            for (int i = 0; i < task.count; ++i) {
                const Id b = order[i];
                const unsigned hit = meet_child(packet.blocks[b], task.parent, task.place);
                order[i] = order[active];
                order[active] = b;
                met[active] = (unsigned char)hit;
                active += hit != 0u;
            }
            if (active == 0) continue;
            child = task.child;
            if (child >= 0) break;
            int n = 0;
            for (int i = 0; i < active; ++i)
                for (unsigned hit = met[i]; hit; hit &= hit - 1u) ids[n++] = (Id)(8 * order[i] + __builtin_ctz(hit));
            leaf(ids, n, child);
            note_hits(packet, ids, n);
            limit = limit_of(packet);
        }
    }
};
