// The way down a trail where treelets are in large ones: roots of these are on the way to others. A ray that waits at a
// large treelet goes in, and through what is above the treelets there.

#undef follow
auto follow = [&](Ray& ray) INLINE -> bool {
    const int level = (ray.trail_code >> 3) + 1, slot = ray.path[PATH_FIRST + level] & 7;
    const char* p = ray.at;
    Floats enter;
    const unsigned met = meet(ray, p, enter);
    const Ints key = ((Ints)enter & ~7) | Ints{0, 1, 2, 3, 4, 5, 6, 7};
    ray.top += put_off(ray, p, enter, met & negative(all_ints(((const int*)&key)[slot]) < key));
    const int child = children_at(p)[slot];
    if (!(met >> slot & 1u)) {
        go_on(ray);
        return true;
    }
    ray.trail_code = 8 * level + slot;
    if (child < 0) {
        if (TWO_LEVEL) return enter_leaf(ray, child, true);
        go_on(ray);
        return true;
    }
    ray.child = child;
    ray.at = address(ray, child);
    ask_for(ray.at);
    if (child & TREELET_CHILD) {
        const int treelet = treelets.of_node.data[(unsigned long long)(ray.at - NODES) / NODE_BYTES];
        if (treelet == listed.locations.data[ray.index]) {  // the trail's end
            if (treelet < (int)treelets.root.shape[0]) go_on(ray);
            else then->nodes[node_count++] = &ray;
            return true;
        }
    }
    then->trails[trail_count++] = &ray;
    return true;
};
