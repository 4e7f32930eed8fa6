// Ordered ray stream traversal: at a node, each ray waits for the child that is next in its own order, which a table
// has by octant; when that child was visited, it waits for the next.

struct alignas(64) Visitor {
    Floats enter;  // into the children, in the order of the ray's octant
    unsigned order, left;  // children in that order, four bits each; bit k: it wants the k-th of them
    int id;
};
struct Frame {
    const char* node;
    Visitor* visitors;
    Id* lists;
    int stride, child, visiting;  // the child slot that is visited, by so many
    unsigned order;               // in which children are looked at
    int counts[8];
};
auto traverse = [&](Ray* set, int count, const char* nodes, const char* triangles, char* room, auto&& leaf) {
    Frame frames[LEVELS];
    Id* const ids = (Id*)room;
    for (int i = 0; i < count; ++i) ids[i] = (Id)i;
    int depth = -1;
    auto put = [&](Frame& frame, int index) INLINE {
        const Visitor& visitor = frame.visitors[index];
        const int k = visitor.order >> (4 * __builtin_ctz(visitor.left)) & 7;
        frame.lists[k * frame.stride + frame.counts[k]++] = (Id)index;
    };
    // The rays `ids` come to a node
    auto open = [&](const char* p, int n) INLINE {
        char* const at = depth < 0 ? room + ((2ll * scratch.size + 63) & ~63ll)
                                   : (char*)(((unsigned long long)(frames[depth].lists + 8 * frames[depth].stride) +
                                              63ull) & ~63ull);
        Frame& frame = frames[++depth];
        frame.node = p;
        frame.visitors = (Visitor*)at;
        frame.stride = n + 37;
        frame.lists = (Id*)(frame.visitors + n);
        for (int k = 0; k < 8; ++k) frame.counts[k] = 0;
        const unsigned* const orders = scratch.orders.data + (p - NODES) / NODE * 8;
        frame.order = orders[set[ids[0]].octant];
        ++nodes_read;
        steps += n;
        int made = 0;
        for (int i = 0; i < n; ++i) {
            const Ray& ray = set[ids[i]];
            Visitor& visitor = frame.visitors[made];
            const unsigned order = orders[ray.octant];
            const Ints turn = ((all_ints((int)order) >> Ints{0, 4, 8, 12, 16, 20, 24, 28}) & 7);
            Floats enter;
            const unsigned met = meet(ray, p, enter);
            // bits in the order of the octant
            const Ints bit = picked(all_ints((int)met) & Ints{1, 2, 4, 8, 16, 32, 64, 128}, turn);
            visitor.enter = (Floats)picked((Ints)enter, turn);
            visitor.order = order;
            visitor.left = negative(bit != 0);
            visitor.id = ids[i];
            if (visitor.left) put(frame, made++);
        }
    };
    open(nodes, count);
    while (depth >= 0) {
        Frame& frame = frames[depth];
        int child = -1, n = 0;
        for (int k = 0; k < 8 && n == 0; ++k) {
            child = frame.order >> (4 * k) & 7;
            n = frame.counts[child];
        }
        if (n != 0) {
            frame.child = child;
            frame.visiting = n;
            frame.counts[child] = 0;
            const Id* const list = frame.lists + child * frame.stride;
            const int code = children_at(frame.node)[child];
            ask_for(address(code, nodes, triangles));
            for (int i = 0; i < n; ++i) ids[i] = (Id)frame.visitors[list[i]].id;
            if (code >= 0 && n > scratch.alone) {
                open(nodes + NODE * code, n);
                continue;
            }
            if (code < 0) leaf(ids, n, code);
            else
                for (int i = 0; i < n; ++i) alone(set, ids[i], code, nodes, triangles, leaf);
        } else if (--depth < 0) {
            break;
        }
        // what was visited is done; its rays wait for their next child, if that is not beyond their closest hit
        Frame& visited = frames[depth];
        const Id* const list = visited.lists + visited.child * visited.stride;
        for (int i = 0; i < visited.visiting; ++i) {
            Visitor& visitor = visited.visitors[list[i]];
            visitor.left &= (visitor.left - 1u) & at_most(visitor.enter, all(set[visitor.id].best));
            if (visitor.left) put(visited, list[i]);
        }
    }
};
