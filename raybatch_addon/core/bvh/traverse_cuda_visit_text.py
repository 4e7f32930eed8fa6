"""Native text for rays in quantised trees that are cut into treelets: how a lane stops at a treelet, and goes on behind it.

As `traverse_cuda_text.py`, of which `traverse_cuda_visit.py` takes all but what a lane holds and its steps.
"""

from __future__ import annotations

# What a lane holds: as in `traverse_cuda_text.py`, but that indices are relative to the blocks of the tree or treelet that the ray is
# in, whose places are the lane's own. Groups of nodes have in bits 8 to 15 the level of the node that holds them, counted from the
# root of the top level or, where there is none, of the mesh; in bit 16 whether they are of a treelet, and then the level is that
# of its root.
VISIT_STATE_TEXT = """
    constexpr unsigned NONE = 0xffffffffu;
    // in `state`
    constexpr unsigned LEVEL = 0x0000ff00u;   // level of the node visited last, or next, above treelets and of their roots
    constexpr unsigned ONE_LEVEL = 0x00000100u;
    constexpr unsigned IN_TREELET = 1u << 16; // the ray is below the root of `treelet`
    constexpr unsigned AT_ROOT = 1u << 17;    // `node` is the root of `treelet`; it is visited when no triangle waits
    constexpr unsigned DESCENDING = 1u << 18; // down the trail towards `treelet`, which is done
    constexpr unsigned CAME = 1u << 19;       // the ray has come from a queue into `treelet`: its way there is in `progress` alone
    constexpr unsigned NODES_ONLY = 1u << 20; // no triangles of `treelet` are there
    constexpr unsigned STOPPED = 1u << 21;    // no more nodes are visited
    constexpr unsigned IN_MESH = 1u << 22;    // with a top level: the ray is below it
    constexpr unsigned TURNED = 1u << 23;     // the ray has come to another tree, for which `ray` is not made yet
    const Words* const resident_nodes = (const Words*)tree.nodes.data;
    const Words* const resident_triangles = (const Words*)tree.triangles.data;
    auto is_nodes = [](const Group& g) -> bool { return g.y > 0x00ffffffu; };

    int slot = -1;                            // of the ray, -1: none
    Ray ray = {};
    float best = 0.0f;                        // distance of the closest hit so far, or t_max
    const Words* nodes = resident_nodes;
    const Words* triangles = resident_triangles;
    unsigned node = NONE;
    Group inner = {0u, 0u}, leaf = {0u, 0u};
    Group later = {0u, 0u};                   // triangles of an earlier node; none unless `leaf` has some
    int depth = 0;                            // groups on the stack
    unsigned state = 0u;
    Group stack[$stack_size + 4];
    // What is seldom used lies behind the stack, in memory: registers are few
    unsigned& position = stack[$stack_size].x;          // of the ray in the batch
    unsigned& entry_level = stack[$stack_size].y;       // `state` at the node that lists `entry`, in its LEVEL
    int& treelet = (int&)stack[$stack_size + 1].x;      // where the ray is, stops, or comes from; -1: none
    unsigned& visit_count = stack[$stack_size + 1].y;
    int no_entry = -1, no_bottom = 0;                   // constants where there is no top level
    int& entry = TWO_LEVEL ? (int&)stack[$stack_size + 2].x : no_entry;     // the tree that the ray is in, -1: the top level
    int& bottom = TWO_LEVEL ? (int&)stack[$stack_size + 2].y : no_bottom;   // groups on the stack that belong to the top level
    unsigned& top_order = stack[$stack_size + 3].x;     // `ray.order` in the top level
    treelet = entry = -1;
    bottom = 0;
    visit_count = 0u;
    unsigned char trail[$trail_size];         // the bit that was taken, by level
    $counters
"""

# Rays begin and end
VISIT_RAY_TEXT = """
    // down the trail: the treelet at its end is not visited again
    auto arrive = [&]() {
        state ^= DESCENDING;
        treelet = -1;
        node = NONE;
    };
    // `node`, which is not in a treelet, may be the root of one; `first` is the first node of the ray's mesh
    auto look_at = [&](unsigned first) {
        const int k = treelets.of_node.data[first + node];
        if (k < 0) return;
        if (TASK != TREELET && (state & DESCENDING)) { arrive(); return; }
        treelet = k;
        state |= AT_ROOT;
    };
    // to the root, and down the trail to what comes after `treelet`
    auto go_back = [&]() {
        state = DESCENDING;
        inner.y = 0u;
        depth = bottom = 0;
        node = 0u;
        if (TWO_LEVEL) {
            entry = -1;
            state |= TURNED;
        } else {
            nodes = resident_nodes;
            triangles = resident_triangles;
            if (treelets.of_node.data[0] == treelet) {  // the tree is one treelet
                state = 0u;
                node = NONE;
                treelet = -1;
            }
        }
    };
    auto take = [&](int ray_position) {
        const int place = where.data[ray_position];
        if (place == DONE || (TASK == TREELET && place < 0)) return;
        position = (unsigned)ray_position;
        slot = slots.data[position];
        const bool any = slot >= any_first;
        best = any || place < 0 ? t_max.data[slot] : hit_t.data[slot];
        inner.y = 0u;
        depth = bottom = 0;
        entry = -1;
        treelet = -1;
        state = 0u;
        node = NONE;
        if (place < 0) {
            if (any) hit_instance.data[slot] = -1; else hit_primitive.data[slot] = -1;
            if (tree.entry_count > 0) {
                node = 0u;
                if (!TWO_LEVEL) look_at(0u);
            }
        } else {
            treelet = place;
            if (TASK == TOP) {
                go_back();
            } else if (TASK == TREELET || treelets.nodes.data[place] != 0) {
                state = CAME | AT_ROOT;
                node = (unsigned)treelets.root.data[place];
                if (TWO_LEVEL) {
                    entry = progress.entry.data[slot];
                    node -= (unsigned)tree.entry_node.data[entry];
                    state |= IN_MESH;
                }
            } else {
                state = CAME | STOPPED;
            }
        }
        if (TWO_LEVEL) {
            state |= TURNED;
        } else {
            nodes = resident_nodes;
            triangles = resident_triangles;
            make_ray();
        }
        $count_begin
    };
    auto finish = [&]() {
        const bool any = slot >= any_first;
        if (treelet >= 0) {
            if (!any) hit_t.data[slot] = best;
            if (TASK != TREELET && !(state & CAME)) {
                const int levels = (int)((state & LEVEL) / ONE_LEVEL);
    #pragma unroll 1
                for (int first = 0, word = 0; first < levels; first += $trail_levels, ++word) {
                    unsigned packed = 0u;
                    for (int j = 0; j < $trail_levels; ++j) packed |= first + j < levels ? (unsigned)trail[first + j] << (5 * j) : 0u;
                    *wp::address(progress.trail, word, slot) = packed;
                }
                if (TWO_LEVEL) progress.entry.data[slot] = entry;
            }
        } else if (!any) {
            const int face = hit_primitive.data[slot];
            int instance = -1, primitive = -1;
            if (face >= 0) identify(TWO_LEVEL ? hit_instance.data[slot] : 0, face, instance, primitive);
            else hit_uv.data[slot] = wp::vec_t<2, float>(0.0f, 0.0f);
            hit_t.data[slot] = best;
            hit_instance.data[slot] = instance;
            hit_primitive.data[slot] = primitive;
        }
        where.data[position] = treelet;
        $count_ray
        slot = -1;
    };
"""

# Steps
VISIT_STEP_TEXT = """
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
        if (visibility.shape[0] != 0 && (tree.entry_visibility.data[e] & visibility.data[slot]) == 0) return;
        go_into(e, bit);
    };
    // to the node of `bit` of the group in hand
    auto go_down = [&](unsigned bit, unsigned mask) {
        const unsigned child = (bit ^ (TWO_LEVEL && !(state & IN_MESH) ? top_order : ray.order)) & 7u;
        node = inner.x + bit_count(mask & ((1u << child) - 1u));
        if (TASK == TREELET || (state & IN_TREELET)) return;
        trail[(mask & LEVEL) / ONE_LEVEL] = (unsigned char)bit;
        state = (state & ~LEVEL) | ((mask & LEVEL) + ONE_LEVEL);
        if (!TWO_LEVEL) look_at(0u); else if (state & IN_MESH) look_at((unsigned)tree.entry_node.data[entry]);
    };
    // what was `hits` of the node, but only what comes after the ray's way, on which it goes on: in the top level entries come
    // first, and triangles were tested before
    auto descend = [&](unsigned hits, unsigned triangle_base) {
        const int level = (int)((state & LEVEL) / ONE_LEVEL);
        const unsigned bit = (*wp::address(progress.trail, level / $trail_levels, slot) >> (5 * (level % $trail_levels))) & 31u;
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
        const Words* p = nodes + 5ull * node;
        const Words a = read(p), b = read(p + 1), c = read(p + 2), d = read(p + 3), e = read(p + 4);
        $count_visit
        const unsigned hits = meet_node(ray, best, a, b, c, d, e);
        node = NONE;
        if (state & AT_ROOT) {
            state ^= AT_ROOT;
            if (hits == 0u && !(state & CAME)) {  // the root is there even if nothing else is, and says that nothing is met
                inner.y = 0u;
                treelet = -1;
                return;
            }
            if (TASK == TOP || (TASK == GO_ON && treelets.nodes.data[treelet] == 0)) {
                state |= STOPPED;
                return;
            }
            nodes = (const Words*)treelets.nodes.data[treelet];
            triangles = (const Words*)treelets.triangles.data[treelet];
            state |= TASK == GO_ON && !triangles ? IN_TREELET | NODES_ONLY : IN_TREELET;
            if (!(state & NODES_ONLY)) { ++visit_count; $count_treelet }
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
    // the next node: of the group, else of the stack; a treelet or tree that is done is left, and the ray is done where all are
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
                nodes = resident_nodes + (TWO_LEVEL ? 5ull * (unsigned)tree.entry_node.data[entry] : 0ull);
                triangles = resident_triangles + (TWO_LEVEL ? 3ull * (unsigned)tree.entry_triangle.data[entry] : 0ull);
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
            if (TWO_LEVEL && !is_nodes(g)) { leaf = g; return; }
            inner = g;
        }
        const unsigned bit = highest_bit(inner.y), mask = inner.y;
        inner.y ^= 1u << bit;
        go_down(bit, mask);
    };
"""
