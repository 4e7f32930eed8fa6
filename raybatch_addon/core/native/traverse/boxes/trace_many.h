// The loop over the rays that one thread carries through a whole tree of the layout BOXES, many at a time.

// Rays by what they do next: visit a node, test a leaf, look for something on the stack, enter a tree of the top level
struct Lists {
    Ray *nodes[CARRIED], *leaves[CARRIED], *pops[CARRIED], *entries[CARRIED];
};
Ray carried[CARRIED];
Lists lists[2];
Lists *now = lists, *then = lists + 1;                                     // of this round and of the next one
long long node_count = 0, leaf_count = 0, pop_count = 0, entry_count = 0;  // of the next one
int taken = first;                                                         // rays that have begun, of all
auto take = [&](Ray& ray) INLINE {
    if (taken >= end) return;
    const int ahead = taken + CARRIED;
    if (ahead < end) {
        const int slot = listed.slots.data[ahead];
        __builtin_prefetch(&rays.origin.data[slot]);
        __builtin_prefetch(&rays.direction.data[slot]);
        __builtin_prefetch(&rays.t_max.data[slot]);
        if (TWO_LEVEL) __builtin_prefetch(&rays.visibility.data[slot]);
    }
    if (begin(ray, listed.slots.data[taken++])) then->nodes[node_count++] = &ray;
    else then->pops[pop_count++] = &ray;  // finds the end
};
// `child` is next if `good` is 1. Every list gets the ray at its end, but only one end moves on.
auto go = [&](Ray& ray, int child, long long good) INLINE {
    const char* p = address(ray, child);
    ask_for(p);
    ray.child = child;
    ray.at = p;
    const long long leaf = (long long)((unsigned)child >> 31) & good;
    const long long entry = TWO_LEVEL ? leaf & (long long)((unsigned)ray.entry >> 31) : 0;
    then->nodes[node_count] = &ray;
    node_count += good ^ leaf;
    then->leaves[leaf_count] = &ray;
    leaf_count += leaf ^ entry;
    then->pops[pop_count] = &ray;
    pop_count += 1 ^ good;
    if (TWO_LEVEL) {
        then->entries[entry_count] = &ray;
        entry_count += entry;
    }
};
// the highest on the stack is next, unless it is an end or beyond the closest hit
auto go_on = [&](Ray& ray) INLINE {
    const int child = ray.waiting[ray.top - 1];
    const long long good = ray.distance[ray.top - 1] <= ray.best;
    ray.top -= good;
    go(ray, child, good);
};
for (int k = 0; k < CARRIED; ++k) {
    clear_stack(carried[k]);
    take(carried[k]);
}
while (node_count + leaf_count + pop_count + entry_count) {
    const long long nodes = node_count, leaves = leaf_count, pops = pop_count, entries = entry_count;
    Lists* const next = now;
    now = then;
    then = next;
    node_count = leaf_count = pop_count = entry_count = 0;
    for (long long i = 0; i < nodes; ++i) {
        Ray& ray = *now->nodes[i];
        Floats enter;
        const unsigned met = meet(ray, ray.at, enter);
        ray.top += put_off(ray, ray.at, enter, met);
        go_on(ray);
    }
    for (long long i = 0; i < leaves; ++i) {
        Ray& ray = *now->leaves[i];
        test_leaf(ray);
        go_on(ray);
    }
    for (long long i = 0; TWO_LEVEL && i < entries; ++i) {
        Ray& ray = *now->entries[i];
        if (enter_tree(ray)) then->nodes[node_count++] = &ray;
        else go_on(ray);
    }
    for (long long i = 0; i < pops; ++i) {
        Ray& ray = *now->pops[i];
        const int child = pop(ray);
        if (__builtin_expect(child == END, 0)) {
            finish(ray);
            take(ray);
        } else if (TWO_LEVEL && child == LEAVE) {
            to_top(ray);
            go_on(ray);
        } else {
            go(ray, child, 1);
        }
    }
}
