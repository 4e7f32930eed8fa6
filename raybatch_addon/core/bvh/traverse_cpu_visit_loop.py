"""Native text: the loop over the rays that one thread carries through a cut tree of the layout BOXES.

`traverse_cpu_visit.py` puts it behind the parts of `traverse_cpu_visit_text.py`.
"""

from __future__ import annotations

LOOP_TEXT = """
    // Rays by what they do next: visit a node, test a leaf, look for something on the stack; and but in TREELET: enter a tree of the
    // top level, come to the root of a treelet, follow their trail one level down
    struct Lists { Ray *nodes[RAYS], *leaves[RAYS], *pops[RAYS], *entries[RAYS], *roots[RAYS], *trails[RAYS]; };
    Ray rays[RAYS];
    Lists lists[2];
    Lists *now = lists, *then = lists + 1;  // of this round and of the next one
    long long node_count = 0, leaf_count = 0, pop_count = 0, entry_count = 0, root_count = 0, trail_count = 0;  // of the next one
    int taken = first;  // rays that have begun, of all
    // `child`, which is at `place`, is next if `good` is 1. Every list gets the ray at its end, but only one end moves on.
    auto go = [&](Ray& ray, int child, int place, long long good) INLINE {
        const char* p = address(ray, child);
        ask_for(p);
        ray.child = child;
        ray.at = p;
        if (PLACES) {
            ray.place = place;
            ray.path[PATH_FIRST + (place >> 3)] = place & 7;
        }
        const long long leaf = (long long)((unsigned)child >> 31) & good;
        const long long entry = TWO_LEVEL && PLACES ? leaf & (long long)((unsigned)ray.entry >> 31) : 0;
        const long long root = PLACES ? (long long)((unsigned)child >> 30 & 1u) & (good ^ leaf) : 0;
        then->nodes[node_count] = &ray;
        node_count += good ^ leaf ^ root;
        then->leaves[leaf_count] = &ray;
        leaf_count += leaf ^ entry;
        then->pops[pop_count] = &ray;
        pop_count += 1 ^ good;
        if (TWO_LEVEL && PLACES) {
            then->entries[entry_count] = &ray;
            entry_count += entry;
        }
        if (PLACES) {
            then->roots[root_count] = &ray;
            root_count += root;
        }
    };
    // the highest on the stack is next, unless it is an end or beyond the closest hit
    auto go_on = [&](Ray& ray) INLINE {
        const int child = ray.waiting[ray.top - 1], place = PLACES ? ray.places[ray.top - 1] : 0;
        const long long good = ray.distance[ray.top - 1] <= ray.best;
        ray.top -= good;
        go(ray, child, place, good);
    };
    // At the root of `treelet`, where `at` is: in, or the ray stops. Whether it goes on
    auto arrive = [&](Ray& ray, int treelet) INLINE -> bool {
        if (TASK == TOP || treelets.nodes.data[treelet] == 0) {
            stop(ray, treelet, ray.place);
            return false;
        }
        to_treelet(ray, treelet);
        then->nodes[node_count++] = &ray;
        return true;
    };
    // Into the mesh tree of `entry`, in which the ray is on a trail if it is `known`. Whether it goes on
    auto enter_mesh = [&](Ray& ray, int entry, bool known) INLINE -> bool {
        const int whole = whole_treelet(entry);
        if (whole >= 0 && (TASK == TOP || treelets.nodes.data[whole] == 0)) {
            if (known) { go_on(ray); return true; }
            ray.entry = entry;
            stop(ray, whole, ray.place);
            return false;
        }
        if (!set_mesh(ray, entry)) {
            to_top(ray);
            go_on(ray);
            return true;
        }
        push(ray, LEAVE, __builtin_nanf(""));
        if (whole >= 0) return arrive(ray, whole);
        if (known) then->trails[trail_count++] = &ray; else then->nodes[node_count++] = &ray;
        return true;
    };
    // A leaf of the top level is next: its first entry, or of a ray on a trail the entry that it is in; those behind wait
    auto enter_leaf = [&](Ray& ray, int child, bool known) INLINE -> bool {
        int code = ~child, entry = tree.top_entry.data[code >> 3];
        if (known) {
            const int stopped_in = progress.entry.data[ray.slot];
            for (; entry != stopped_in && (code & 7); entry = tree.top_entry.data[code >> 3]) code += 7;  // one further, one less
        }
        if (code & 7) push(ray, ~(code + 7), 0.0f);
        if (!known && visibility.shape[0] != 0 && !(tree.entry_visibility.data[entry] & visibility.data[ray.slot])) {
            go_on(ray);
            return true;
        }
        return enter_mesh(ray, entry, known);
    };
    // One level down along the trail: what comes behind the child that the ray was in waits. Whether it goes on
    auto follow = [&](Ray& ray) INLINE -> bool {
        const int level = (ray.place >> 3) + 1, slot = ray.path[PATH_FIRST + level] & 7;
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
        const int child = ((const int*)(p + 192))[slot];
        ray.place = 8 * level + slot;
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
        if (child & TREELET_CHILD) then->roots[root_count++] = &ray; else then->trails[trail_count++] = &ray;
        return true;
    };
    // The ray `index` of the batch begins, if there is anything to do. Whether it goes on
    auto start = [&](Ray& ray, int index) INLINE -> bool {
        const int slot = slots.data[index], at = where.data[index];
        if (TASK == TREELET) {
            if (at < 0) return false;
            load(ray, index, slot, false);
            const bool sound = set_mesh(ray, TWO_LEVEL ? progress.entry.data[slot] : 0);
            to_treelet(ray, at);
            ray.at = NODES + 256ll * treelets.root.data[at];
            if (sound) then->nodes[node_count++] = &ray; else then->pops[pop_count++] = &ray;
            return true;
        }
        if (at == DONE) return false;
        if (TASK == GO_ON && at >= 0 && treelets.nodes.data[at] == 0) {
            COUNT_WAITING
            return false;
        }
        load(ray, index, slot, at == NEW);
        const bool sound = TWO_LEVEL ? set_top(ray) : set_mesh(ray, 0);
        if (!sound) {
            then->pops[pop_count++] = &ray;  // finds the end
            return true;
        }
        const int whole = TWO_LEVEL ? -1 : whole_treelet(0);
        if (at == NEW) {
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
            const int ahead = taken + RAYS;
            if (ahead < end) {
                const int slot = slots.data[ahead];
                __builtin_prefetch(&origin.data[slot]);
                __builtin_prefetch(&direction.data[slot]);
                __builtin_prefetch(slot < any_first && where.data[ahead] >= 0 ? &hit_t.data[slot] : &t_max.data[slot], 1);
                __builtin_prefetch(&hit_instance.data[slot], 1);
                __builtin_prefetch(&hit_primitive.data[slot], 1);
                if (TWO_LEVEL) __builtin_prefetch(&progress.entry.data[slot], 1);
                if (PLACES) __builtin_prefetch(trail_word(0, slot), 1);
                if (PLACES && TWO_LEVEL) __builtin_prefetch(&visibility.data[slot]);
            }
            goes_on = start(ray, taken++);
        }
    };
    auto take_next = [&](Ray& ray) INLINE { if (!TOGETHER) take(ray); };
    for (int k = 0; k < RAYS; ++k) clear_places(rays[k]);
    do {
        for (int k = 0; k < RAYS; ++k) take(rays[k]);
        while (node_count + leaf_count + pop_count + entry_count + root_count + trail_count) {
            const long long nodes = node_count, leaves = leaf_count, pops = pop_count, entries = entry_count, roots = root_count, trails = trail_count;
            Lists* const next = now;
            now = then;
            then = next;
            node_count = leaf_count = pop_count = entry_count = root_count = trail_count = 0;
            for (long long i = 0; i < nodes; ++i) {
                Ray& ray = *now->nodes[i];
                Floats enter;
                const unsigned met = meet(ray, ray.at, enter);
                ray.top += put_off(ray, ray.at, enter, met);
                go_on(ray);
            }
            for (long long i = 0; i < leaves; ++i) {
                Ray& ray = *now->leaves[i];
                if (TASK == GO_ON && __builtin_expect(!ray.triangles, 0)) {  // they must be there first
                    stop(ray, ray.treelet, ray.treelet_place);
                    take_next(ray);
                    continue;
                }
                test_leaf(ray);
                go_on(ray);
            }
            for (long long i = 0; TWO_LEVEL && PLACES && i < entries; ++i) {
                Ray& ray = *now->entries[i];
                if (!enter_leaf(ray, ray.child, false)) take_next(ray);
            }
            for (long long i = 0; PLACES && i < roots; ++i) {
                Ray& ray = *now->roots[i];
                const int treelet = treelets.of_node.data[(ray.at - NODES) >> 8];
                if (TASK == GO_ON) push(ray, BACK, __builtin_nanf(""));
                if (!arrive(ray, treelet)) take_next(ray);
            }
            for (long long i = 0; PLACES && i < trails; ++i) {
                Ray& ray = *now->trails[i];
                if (!follow(ray)) take_next(ray);
            }
            for (long long i = 0; i < pops; ++i) {
                Ray& ray = *now->pops[i];
                const int child = pop(ray);
                if (__builtin_expect(child == END, 0)) {
                    stop(ray, TASK != TREELET || (ray.any && ray.face >= 0) ? DONE : ray.treelet, -8);
                    take_next(ray);
                } else if (TWO_LEVEL && PLACES && child == LEAVE) {
                    to_top(ray);
                    go_on(ray);
                } else if (TASK == GO_ON && child == BACK) {
                    to_mesh(ray);
                    go_on(ray);
                } else {
                    go(ray, child, PLACES ? ray.places[ray.top] : 0, 1);
                }
            }
        }
    } while (TOGETHER && taken < end);
    progress.visits.data[0] += visits;
"""
