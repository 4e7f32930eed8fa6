// The loop of a warp whose rays go through the top level together: all lanes that visit a node in a turn visit the same.
//
// Each ray keeps the order of its own octant, and the place that it has come to there: nothing that another ray does
// moves it, so that it visits what it would visit alone. Common is the turn. The warp elects one of the nodes that its
// rays want to visit next: the one furthest down, of those the one that most rays want. So it goes depth first through
// what any of its rays wants, into no branch that none wants, and rays that parted meet again behind the branch. A ray
// that wants another node sulks: its lane waits.
//
// The loop ends. When rays have been taken, each has a node to visit, or is through (`to_node`). So in each turn all
// lanes are idle, and rays are taken or the list is at its end, or a node is elected, and at least one ray visits it
// and comes further in its own order, in which each node comes once. With SHORT_SEGMENTS what is put back comes further,
// too, over all launches: a segment ends only where a ray enters a treelet, or where all of them are done, so that of
// the rays that a warp takes at least one does not wait in an exit queue again before it has visited a treelet.

const int ray_count = listed.count.data[0];
bool more = true;  // the list has rays that no lane has taken
// triangles are tested in the turn in which they are met, so that none waits
auto is_busy = [&]() -> bool { return node != NONE; };
// on to the next node, unless the ray is through
auto to_node = [&]() {
    while (node == NONE && !(state & STOPPED)) {
        const bool in_top = TWO_LEVEL && in_top_level();
        if (in_top && leaf.y) enter();
        else if (!is_nodes(inner) && depth == 0 && (!TWO_LEVEL || in_top)) return;
        else choose();
    }
};
auto hand_in = [&]() {
    const int at = treelet;
    finish();
    // the treelet's entry queue
    if (SHORT_SEGMENTS && at >= 0) listed.locations.data[list_index] = 2 * at;
};
auto lowest_bit = [&](unsigned x) -> unsigned { return (unsigned)bit_count((x & (0u - x)) - 1u); };
#if COUNTERS && !defined(__CUDA_ARCH__) && LANES > 1
long long fetches = 0;
#endif
for (;;) {
    const unsigned idle = vote([&]() { return !is_busy(); });
    const int wanted = SINGLE_LANE ? 1 : bit_count(idle);
    if (idle == WARP || (more && wanted >= REFILL)) {
        each_lane([&]() {
            if (!is_busy() && slot >= 0) hand_in();
        });
        if (!more) break;
        const int first = draw(wanted);
        each_lane([&]() {
            const int mine = first + bit_count(idle & lanes_before());
            if (is_busy() || mine >= (SINGLE_LANE && lanes_before() != 0u ? 0 : ray_count)) return;
            take(mine);
            to_node();
        });
        more = first + wanted < ray_count;
    }
    each_lane([&]() {
#if COUNTERS
        count_lanes(0, is_busy());
#endif
        if (TWO_LEVEL && is_busy()) renew_ray();
        where = is_busy() ? (unsigned long long)(nodes + NODE * node) : 0ull;
    });
    find_peers();
    each_lane([&]() {
        const unsigned level = (state & LEVEL) / ONE_LEVEL;
        key = where ? level << 11 | (unsigned)bit_count(peers) << 5 | lowest_bit(peers) : 0u;
    });
    const unsigned elected = largest([&]() { return key; });
    auto may_step = [&]() -> bool { return key != 0u && (key == elected || !ELECTS); };
#if COUNTERS && !defined(__CUDA_ARCH__) && LANES > 1
    // nodes that the warp fetches in this turn, and its lanes that wait meanwhile
    const unsigned stepping = vote(may_step);
    fetches += bit_count(vote([&]() { return may_step() && !(peers & lanes_before()); }));
    lanes_there[1] += stepping ? LANES - bit_count(stepping) : 0;
#endif
    each_lane([&]() {
        if (!may_step()) return;
#if SHORT_SEGMENTS
        visit_on();
#else
        visit();
#endif
        while (leaf.y && (!TWO_LEVEL || (state & IN_MESH))) test();
        to_node();
    });
#if SHORT_SEGMENTS
    const unsigned entering = vote([&]() { return slot >= 0 && (state & STOPPED) && treelet >= 0; });
    if (entering) {
        const int met = heard_from(lowest_bit(entering), [&]() { return treelet; });
        each_lane([&]() {
            if (is_busy()) skip(met);
        });
    }
#endif
}
#if COUNTERS
#if !defined(__CUDA_ARCH__) && LANES > 1
if (counts.lanes.shape[0] > 6) counts.lanes.data[6] += fetches;
#endif
report_lanes();
#endif
