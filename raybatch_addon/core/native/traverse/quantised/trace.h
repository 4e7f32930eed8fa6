// How a lane takes rays through a whole quantised tree.

auto take = [&](int index) {
    slot = listed.slots.data[index];
    best = rays.t_max.data[slot];
    if (ANY_HIT) rays.hit_instance.data[slot] = -1;
    else rays.hit_primitive.data[slot] = -1;
    node = tree.entry_count > 0 ? TWO_LEVEL ? top_node_of(slot) : 0u : NONE;
    if (TWO_LEVEL) turned = true;
    else make_ray();
#if COUNTERS
    visits = boxes = tests = 0;
#endif
};
auto finish = [&]() {
    if (!ANY_HIT) write_hit();
#if COUNTERS
    counts.node_steps.data[slot] = visits;
    counts.box_tests.data[slot] = boxes;
    counts.triangle_tests.data[slot] = tests;
#endif
    slot = -1;
};
// into the tree of an entry; what is left of the top level comes later
auto enter = [&]() {
    const unsigned bit = highest_bit(leaf.y);
    leaf.y ^= 1u << bit;
    const int e = tree.top_entry.data[leaf.x + bit];
    if (rays.visibility.shape[0] != 0 && (tree.entry_visibility.data[e] & rays.visibility.data[slot]) == 0) return;
    if (is_nodes(inner)) stack[depth++] = inner;
    if (leaf.y) stack[depth++] = leaf;
    inner.y = leaf.y = 0u;
    bottom = depth;
    entry = e;
    node = tree.entry_node.data[e];
    turned = true;
};
auto renew_ray = [&]() {
    if (turned) make_ray();
    turned = false;
};
// the node
auto visit = [&]() {
    if (is_nodes(inner)) stack[depth++] = inner;
    const Words* p = nodes + NODE * node;
    const Words a = read(p), b = read(p + 1), c = read(p + 2), d = read(p + 3), e = read(p + 4);
#if COUNTERS
    count_node(b);
#endif
    const unsigned hits = meet_node(ray, best, a, b, c, d, e);
    node = NONE;
    inner.x = b.x + first_node;
    inner.y = (hits & 0xff000000u) | a.w >> 24;
    if (hits & 0x00ffffffu) {
        later = leaf;
        leaf.x = b.y + first_triangle;
        leaf.y = hits & 0x00ffffffu;
    }
};
// the next node: of the group, else of the stack; a tree that is done is left, and with the top level the ray is done
auto choose = [&]() {
    const bool in_mesh = !TWO_LEVEL || entry >= 0;
    if (!in_mesh && leaf.y) return;
    if (!is_nodes(inner)) {
        if (depth == bottom) {
            if (leaf.y) return;
            if (TWO_LEVEL && in_mesh) {
                entry = -1;
                bottom = 0;
                turned = true;
            }
            if (depth == 0) return;
        }
        const Group g = stack[--depth];
        if (TWO_LEVEL && !is_nodes(g)) {
            leaf = g;
            return;
        }
        inner = g;
    }
    const unsigned bit = highest_bit(inner.y), mask = inner.y;
    inner.y ^= 1u << bit;
    const unsigned child = (bit ^ (TWO_LEVEL && entry < 0 ? top_order : ray.order)) & 7u;
    node = inner.x + bit_count(mask & ((1u << child) - 1u));
};
