// The rays that one thread carries through a cut tree of the layout BOXES: which list a ray comes on next.

// Rays by what they do next: visit a node, test a leaf, look for something on the stack; and, except in TREELET, enter
// a tree of the top level, come to the root of a treelet, follow their trail one level down
struct Lists {
    Ray *nodes[CARRIED], *leaves[CARRIED], *pops[CARRIED], *entries[CARRIED], *roots[CARRIED], *trails[CARRIED];
};
Ray carried[CARRIED];
Lists lists[2];
Lists *now = lists, *then = lists + 1;  // of this round and of the next one
// Lengths of the lists of the next round
long long node_count = 0, leaf_count = 0, pop_count = 0, entry_count = 0, root_count = 0, trail_count = 0;
int taken = first;  // rays that have begun, of all
// `child`, which has this trail code, is next if `good` is 1. Every list gets the ray at its end, but only one end
// moves on.
auto go = [&](Ray& ray, int child, int trail_code, long long good) INLINE {
    const char* p = address(ray, child);
    ask_for(p);
    ray.child = child;
    ray.at = p;
    if (KEEPS_TRAIL) {
        ray.trail_code = trail_code;
        ray.path[PATH_FIRST + (trail_code >> 3)] = trail_code & 7;
    }
    const long long leaf = (long long)((unsigned)child >> 31) & good;
    const long long entry = TWO_LEVEL && KEEPS_TRAIL ? leaf & (long long)((unsigned)ray.entry >> 31) : 0;
    const long long root = KEEPS_TRAIL ? (long long)((child & TREELET_CHILD) != 0) & (good ^ leaf) : 0;
    then->nodes[node_count] = &ray;
    node_count += good ^ leaf ^ root;
    then->leaves[leaf_count] = &ray;
    leaf_count += leaf ^ entry;
    then->pops[pop_count] = &ray;
    pop_count += 1 ^ good;
    if (TWO_LEVEL && KEEPS_TRAIL) {
        then->entries[entry_count] = &ray;
        entry_count += entry;
    }
    if (KEEPS_TRAIL) {
        then->roots[root_count] = &ray;
        root_count += root;
    }
};
// the highest on the stack is next, unless it is an end or beyond the closest hit
auto go_on = [&](Ray& ray) INLINE {
    const int child = ray.waiting[ray.top - 1], trail_code = KEEPS_TRAIL ? ray.trail_codes[ray.top - 1] : 0;
    const long long good = ray.distance[ray.top - 1] <= ray.best;
    ray.top -= good;
    go(ray, child, trail_code, good);
};
// At the root of `treelet`, which `at` is the address of: in, or the ray stops. Whether it goes on
auto arrive = [&](Ray& ray, int treelet) INLINE -> bool {
    if (TASK == TOP || is_absent(treelet)) {
        stop(ray, treelet, ray.trail_code);
        return false;
    }
    to_treelet(ray, treelet);
    then->nodes[node_count++] = &ray;
    return true;
};
// Into the mesh tree of `entry`, in which the ray is on a trail if it is `known`. Whether it goes on
auto enter_mesh = [&](Ray& ray, int entry, bool known) INLINE -> bool {
    const int whole = whole_treelet(entry);
    if (whole >= 0 && (TASK == TOP || is_absent(whole))) {
        if (known) {
            go_on(ray);
            return true;
        }
        ray.entry = entry;
        stop(ray, whole, ray.trail_code);
        return false;
    }
    if (!set_mesh(ray, entry)) {
        to_top(ray);
        go_on(ray);
        return true;
    }
    push(ray, LEAVE, __builtin_nanf(""));
    if (whole >= 0) return arrive(ray, whole);
    if (known) then->trails[trail_count++] = &ray;
    else then->nodes[node_count++] = &ray;
    return true;
};
// A leaf of the top level is next: its first entry, or of a ray on a trail the entry that it is in; those behind wait
auto enter_leaf = [&](Ray& ray, int child, bool known) INLINE -> bool {
    int code = ~child, entry = tree.top_entry.data[code >> 3];
    if (known) {
        const int stopped_in = progress.entry.data[ray.slot];
        for (; entry != stopped_in && (code & 7); entry = tree.top_entry.data[code >> 3])
            code += 7;  // one further, one less
    }
    if (code & 7) push(ray, ~(code + 7), 0.0f);
    if (!known && rays.visibility.shape[0] != 0 &&
        !(tree.entry_visibility.data[entry] & rays.visibility.data[ray.slot])) {
        go_on(ray);
        return true;
    }
    return enter_mesh(ray, entry, known);
};
// One level down along the trail: what comes behind the child that the ray was in waits. Whether it goes on
auto follow = [&](Ray& ray) INLINE -> bool {
    const int level = (ray.trail_code >> 3) + 1, slot = ray.path[PATH_FIRST + level] & 7;
    const char* p = ray.at;
    Floats enter;
    const unsigned met = meet(ray, p, enter);
    // in the order of `put_off`
    const Ints key = ((Ints)enter & ~7) | Ints{0, 1, 2, 3, 4, 5, 6, 7};
    const unsigned behind = negative(all_ints(((const int*)&key)[slot]) < key);
    ray.top += put_off(ray, p, enter, met & behind);
    if (!(met >> slot & 1u)) {  // a closer hit was found since
        go_on(ray);
        return true;
    }
    const int child = children_at(p)[slot];
    ray.trail_code = 8 * level + slot;
    if (child < 0) {
        if (TWO_LEVEL) return enter_leaf(ray, child, true);
        go_on(ray);
        return true;
    }
    if (TASK == TOP && (child & TREELET_CHILD)) {  // the ray was there
        go_on(ray);
        return true;
    }
    ray.child = child;
    ray.at = address(ray, child);
    ask_for(ray.at);
    if (child & TREELET_CHILD) then->roots[root_count++] = &ray;
    else then->trails[trail_count++] = &ray;
    return true;
};
// The ray `index` of the list begins, if there is anything to do. Whether it goes on
auto start = [&](Ray& ray, int index) INLINE -> bool {
    const int slot = listed.slots.data[index], location = listed.locations.data[index];
    if (TASK == TREELET) {
        if (location < 0) return false;
        load(ray, index, slot, false);
        const bool sound = set_mesh(ray, TWO_LEVEL ? progress.entry.data[slot] : 0);
        to_treelet(ray, location);
        ray.at = NODES + NODE * treelets.root.data[location];
        if (sound) then->nodes[node_count++] = &ray;
        else then->pops[pop_count++] = &ray;
        return true;
    }
    if (location == DONE) return false;
    if (TASK == GO_ON && location >= 0 && is_absent(location)) {
#if COUNTERS
        ++counts.queued.data[slot];
#endif
        return false;
    }
    load(ray, index, slot, location == NEW);
    const bool sound = TWO_LEVEL ? set_top(ray) : set_mesh(ray, 0);
    if (!sound) {
        then->pops[pop_count++] = &ray;  // finds the end
        return true;
    }
    const int whole = TWO_LEVEL ? -1 : whole_treelet(0);
    if (location == NEW) {
        if (whole >= 0) return arrive(ray, whole);
        then->nodes[node_count++] = &ray;
        return true;
    }
    if (whole >= 0) {
        if (TASK == GO_ON) return arrive(ray, whole);
        then->pops[pop_count++] = &ray;
        return true;
    }
    const int words = progress.trail.shape[0] < 31 ? progress.trail.shape[0] : 31;
    for (int k = 0; k < words; ++k) unpack(*trail_word(k, slot), ray.path + PATH_FIRST + TRAIL_LEVELS * k);
    then->trails[trail_count++] = &ray;
    return true;
};
auto take = [&](Ray& ray) INLINE {
    for (bool goes_on = false; !goes_on && taken < end;) {
        const int ahead = taken + CARRIED;
        if (ahead < end) {
            const int slot = listed.slots.data[ahead];
            const bool goes_on_at_hit = slot < listed.any_first && listed.locations.data[ahead] >= 0;
            __builtin_prefetch(&rays.origin.data[slot]);
            __builtin_prefetch(&rays.direction.data[slot]);
            __builtin_prefetch(goes_on_at_hit ? &rays.hit_t.data[slot] : &rays.t_max.data[slot], 1);
            __builtin_prefetch(&rays.hit_instance.data[slot], 1);
            __builtin_prefetch(&rays.hit_primitive.data[slot], 1);
            if (TWO_LEVEL) __builtin_prefetch(&progress.entry.data[slot], 1);
            if (KEEPS_TRAIL) __builtin_prefetch(trail_word(0, slot), 1);
            if (KEEPS_TRAIL && TWO_LEVEL) __builtin_prefetch(&rays.visibility.data[slot]);
        }
        goes_on = start(ray, taken++);
    }
};
