// The steps of a lane in a quantised tree that is cut into treelets.

// into the tree of an entry, which is that of `bit` in the group of its node; what is left of the top level comes later
auto go_into = [&](int e, unsigned bit) {
    if (is_nodes(inner)) stack[depth++] = inner;
    if (leaf.y) stack[depth++] = leaf;
    inner.y = leaf.y = 0u;
    bottom = depth;
    entry = e;
    node = 0u;
    state |= IN_MESH | TURNED;
    entry_level = state & LEVEL;
    trail[entry_level / ONE_LEVEL] = (unsigned char)bit;
    state += ONE_LEVEL;
    look_at((unsigned)tree.entry_node.data[e]);
};
auto enter = [&]() {
    const unsigned bit = highest_bit(leaf.y);
    leaf.y ^= 1u << bit;
    const int e = tree.top_entry.data[leaf.x + bit];
    if (rays.visibility.shape[0] != 0 && (tree.entry_visibility.data[e] & rays.visibility.data[slot]) == 0) return;
    go_into(e, bit);
};
// to the node of `bit` of the group in hand
auto go_down = [&](unsigned bit, unsigned mask) {
    const unsigned child = (bit ^ (TWO_LEVEL && !(state & IN_MESH) ? top_order : ray.order)) & 7u;
    node = inner.x + bit_count(mask & ((1u << child) - 1u));
    if (TASK == TREELET || (state & IN_TREELET)) return;
    trail[(mask & LEVEL) / ONE_LEVEL] = (unsigned char)bit;
    state = (state & ~LEVEL) | ((mask & LEVEL) + ONE_LEVEL);
    if (!TWO_LEVEL) look_at(0u);
    else if (state & IN_MESH) look_at((unsigned)tree.entry_node.data[entry]);
};
// what was `hits` of the node, but only what comes after the ray's way, on which it goes on: in the top level entries
// come first, and triangles were tested before
auto descend = [&](unsigned hits, unsigned triangle_base) {
    const int level = (int)((state & LEVEL) / ONE_LEVEL);
    const unsigned word = *wp::address(progress.trail, level / TRAIL_LEVELS, slot);
    const unsigned bit = (word >> (5 * (level % TRAIL_LEVELS))) & 31u;
    const bool met = (hits >> bit & 1u) != 0u;
    if (bit < 24u) {
        leaf.x = triangle_base;
        leaf.y = hits & ((1u << bit) - 1u);
    } else {
        inner.y &= 0x00ffffffu | ((1u << bit) - 1u);
    }
    if (!met) arrive();
    else if (!TWO_LEVEL || bit >= 24u) go_down(bit, inner.y);
    else go_into(tree.top_entry.data[triangle_base + bit], bit);
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
    if (state & AT_ROOT) {
        state ^= AT_ROOT;
        // the root is there even if nothing else is, and says that nothing is met
        if (hits == 0u && !(state & CAME)) {
            inner.y = 0u;
            treelet = -1;
            return;
        }
        if (TASK == TOP || (TASK == GO_ON && treelets.nodes.data[treelet] == 0)) {
            state |= STOPPED;
            return;
        }
        to_treelet_blocks();
        state |= TASK == GO_ON && !triangles ? IN_TREELET | NODES_ONLY : IN_TREELET;
        if (!(state & NODES_ONLY)) {
            ++visit_count;
#if COUNTERS
            ++entered;
#endif
        }
    }
    inner.x = b.x;
    inner.y = (hits & 0xff000000u) | (state & (LEVEL | IN_TREELET)) | a.w >> 24;
    if (TASK != TREELET && (state & DESCENDING)) {
        descend(hits, b.y);
    } else if (hits & 0x00ffffffu) {
        if (TASK == GO_ON && (state & NODES_ONLY)) {  // none can wait from before
            state |= STOPPED;
            return;
        }
        later = leaf;
        leaf.x = b.y;
        leaf.y = hits & 0x00ffffffu;
    }
};
// the next node: of the group, else of the stack; a treelet or tree that is done is left, and with the last of them the
// ray is done
auto choose = [&]() {
    if (state & STOPPED) return;
    const bool in_mesh = !TWO_LEVEL || (state & IN_MESH);
    if (!in_mesh && leaf.y) return;
    if (!is_nodes(inner)) {
        if (TASK != TOP && (state & IN_TREELET) && (depth == bottom || !(stack[depth - 1].y & IN_TREELET))) {
            if (leaf.y) return;
            if (TASK == TREELET) {
                state |= STOPPED;
                return;
            }
            if (state & CAME) {
                go_back();
                return;
            }
            state &= ~(IN_TREELET | NODES_ONLY);
            treelet = -1;
            nodes = resident_nodes + (TWO_LEVEL ? NODE * (unsigned)tree.entry_node.data[entry] : 0ull);
            triangles = resident_triangles + (TWO_LEVEL ? TRIANGLE * (unsigned)tree.entry_triangle.data[entry] : 0ull);
#if MOTION
            between = between_steps(tree.entry_deform.data[entry], time_of(slot));
#endif
        }
        if (depth == bottom) {
            if (leaf.y) return;
            if (TWO_LEVEL && in_mesh) {
                entry = -1;
                bottom = 0;
                state = (state & ~(LEVEL | IN_MESH)) | TURNED | entry_level;
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
    go_down(bit, mask);
};
