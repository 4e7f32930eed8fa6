// SHORT_SEGMENT: rays that stop before a node, which need not be a treelet's root, and go on from there.
//
// The trail leads to the node that the ray would have visited next, in the order of its own octant. The word with the
// trail's last level says so: its highest bit is set, and of the others the highest marks where the level ends. Trails
// that lead to a treelet have neither: their words have 30 bits.

constexpr unsigned CUT = 1u << 31;
static_assert(5 * TRAIL_LEVELS < 31, "the last level's mark lies below CUT");

// the ray waits behind `met`, a treelet that it need not have come to, and has seen what it has seen
auto skip = [&](int met) {
    int location = 2 * met + 1;
    if (!(state & DESCENDING)) {  // else it has not come to the end of its trail, which stays as it is
        const int levels = (int)((state & LEVEL) / ONE_LEVEL);
        if (levels == 0) location = NEW;
        for (int first = 0, word = 0; first < levels; first += TRAIL_LEVELS, ++word) {
            unsigned packed = 0u;
            for (int j = 0; j < TRAIL_LEVELS && first + j < levels; ++j)
                packed |= (unsigned)trail[first + j] << (5 * j);
            if (levels - first <= TRAIL_LEVELS) packed |= CUT | 1u << (5 * (levels - first));
            *wp::address(progress.trail, word, slot) = packed;
        }
    }
    if (!asks_any()) rays.hit_t.data[slot] = best;
    listed.locations.data[list_index] = location;
#if COUNTERS
    counts.node_steps.data[slot] += visits;
    counts.box_tests.data[slot] += boxes;
    counts.triangle_tests.data[slot] += tests;
    counts.queued.data[slot] += 1;
#endif
    node = NONE;
    slot = -1;
};
// `visit`, which at the last level of a trail that was cut goes on with the child that the trail leads to
auto visit_on = [&]() {
    bool ends = false;
    unsigned bit = 0u;
    if (state & DESCENDING) {
        const int level = (int)((state & LEVEL) / ONE_LEVEL), j = level % TRAIL_LEVELS;
        const unsigned word = *wp::address(progress.trail, level / TRAIL_LEVELS, slot);
        bit = (word >> (5 * j)) & 31u;
        ends = word >= CUT && highest_bit(word ^ CUT) == 5u * (unsigned)(j + 1);
        if (ends) {
            state ^= DESCENDING;
            treelet = -1;
        }
    }
    visit();
    if (!ends) return;
    // children before it are done; entries come before nodes, and triangles were tested
    const unsigned kept = (2u << bit) - 1u;
    if (bit < 24u) {
        leaf.y &= kept;
    } else {
        leaf.y = 0u;
        inner.y &= 0x00ffffffu | kept;
    }
};
