// How the rays of a lane begin and end in a quantised tree that is cut into treelets.

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
    if (TASK != TREELET && (state & DESCENDING)) {
        arrive();
        return;
    }
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
auto take = [&](int index) {
    const int location = listed.locations.data[index];
    if (location == DONE || (TASK == TREELET && location < 0)) return;
    list_index = (unsigned)index;
    slot = listed.slots.data[list_index];
    const bool any = asks_any();
    best = any || location < 0 ? rays.t_max.data[slot] : rays.hit_t.data[slot];
    inner.y = 0u;
    depth = bottom = 0;
    entry = -1;
    treelet = -1;
    state = 0u;
    node = NONE;
    if (location < 0) {
        if (any) rays.hit_instance.data[slot] = -1;
        else rays.hit_primitive.data[slot] = -1;
        if (tree.entry_count > 0) {
            node = 0u;
            if (!TWO_LEVEL) look_at(0u);
        }
    } else {
        treelet = location;
        if (TASK == TOP) {
            go_back();
        } else if (TASK == TREELET || treelets.nodes.data[location] != 0) {
            state = CAME | AT_ROOT;
            node = (unsigned)treelets.root.data[location];
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
#if COUNTERS
    visits = boxes = tests = entered = 0;
    if (location < 0) {
        counts.node_steps.data[slot] = counts.box_tests.data[slot] = counts.triangle_tests.data[slot] = 0;
        counts.treelet_visits.data[slot] = counts.queued.data[slot] = 0;
    }
#endif
};
auto finish = [&]() {
    const bool any = asks_any();
    if (treelet >= 0) {
        if (!any) rays.hit_t.data[slot] = best;
        if (TASK != TREELET && !(state & CAME)) {
            const int levels = (int)((state & LEVEL) / ONE_LEVEL);
#pragma unroll 1
            for (int first = 0, word = 0; first < levels; first += TRAIL_LEVELS, ++word) {
                unsigned packed = 0u;
                for (int j = 0; j < TRAIL_LEVELS; ++j)
                    packed |= first + j < levels ? (unsigned)trail[first + j] << (5 * j) : 0u;
                *wp::address(progress.trail, word, slot) = packed;
            }
            if (TWO_LEVEL) progress.entry.data[slot] = entry;
        }
    } else if (!any) {
        write_hit();
    }
    listed.locations.data[list_index] = treelet;
#if COUNTERS
    counts.node_steps.data[slot] += visits;
    counts.box_tests.data[slot] += boxes;
    counts.triangle_tests.data[slot] += tests;
    counts.treelet_visits.data[slot] += entered;
    counts.queued.data[slot] += treelet >= 0 ? 1 : 0;
#endif
    slot = -1;
};
auto renew_ray = [&]() {
    if (state & TURNED) {
        make_ray();
        state ^= TURNED;
    }
};
