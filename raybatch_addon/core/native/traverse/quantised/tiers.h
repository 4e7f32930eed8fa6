// Treelets are in large ones: roots of these are on the way to others. A ray that waits at a large treelet goes in, and
// through what is above the treelets there.

#undef look_at
auto look_at = [&](unsigned first) {
    const int k = treelets.of_node.data[first + node];
    if (k < 0) return;
    if (state & DESCENDING) {
        if (k != listed.locations.data[list_index]) return;
        if (k < (int)treelets.root.shape[0]) {
            arrive();
            return;
        }
        state ^= DESCENDING;
        treelet = -1;
        return;
    }
    treelet = k;
    state |= AT_ROOT;
};
