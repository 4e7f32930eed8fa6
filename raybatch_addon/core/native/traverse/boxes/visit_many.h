// The loop over the rays that one thread carries through a cut tree of the layout BOXES.

auto take_next = [&](Ray& ray) INLINE {
    if (!TOGETHER) take(ray);
};
for (int k = 0; k < CARRIED; ++k) {
    clear_stack(carried[k]);
    for (int j = 0; j < 8; ++j) carried[k].trail_codes[j] = -8;
}
do {
    for (int k = 0; k < CARRIED; ++k) take(carried[k]);
    while (node_count + leaf_count + pop_count + entry_count + root_count + trail_count) {
        const long long nodes = node_count, leaves = leaf_count, pops = pop_count;
        const long long entries = entry_count, roots = root_count, trails = trail_count;
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
                stop(ray, ray.treelet, ray.treelet_trail_code);
                take_next(ray);
                continue;
            }
            test_leaf(ray);
            go_on(ray);
        }
        for (long long i = 0; TWO_LEVEL && KEEPS_TRAIL && i < entries; ++i) {
            Ray& ray = *now->entries[i];
            if (!enter_leaf(ray, ray.child, false)) take_next(ray);
        }
        for (long long i = 0; KEEPS_TRAIL && i < roots; ++i) {
            Ray& ray = *now->roots[i];
            const int treelet = treelets.of_node.data[(unsigned long long)(ray.at - NODES) / NODE_BYTES];
            if (TASK == GO_ON) push(ray, BACK, __builtin_nanf(""));
            if (!arrive(ray, treelet)) take_next(ray);
        }
        for (long long i = 0; KEEPS_TRAIL && i < trails; ++i) {
            Ray& ray = *now->trails[i];
            if (!follow(ray)) take_next(ray);
        }
        for (long long i = 0; i < pops; ++i) {
            Ray& ray = *now->pops[i];
            const int child = pop(ray);
            if (__builtin_expect(child == END, 0)) {
                stop(ray, TASK != TREELET || (ray.any && ray.face >= 0) ? DONE : ray.treelet, -8);
                take_next(ray);
            } else if (TWO_LEVEL && KEEPS_TRAIL && child == LEAVE) {
                to_top(ray);
                go_on(ray);
            } else if (TASK == GO_ON && child == BACK) {
                to_mesh(ray);
                go_on(ray);
            } else {
                go(ray, child, KEEPS_TRAIL ? ray.trail_codes[ray.top] : 0, 1);
            }
        }
    }
} while (TOGETHER && taken < end);
progress.visits.data[0] += visits;
