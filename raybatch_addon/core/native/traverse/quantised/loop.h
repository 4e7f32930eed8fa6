// The loop of a lane: in each turn it visits one node and tests one triangle of its ray.

const int ray_count = listed.count.data[0];
bool more = true;  // the list has rays that no lane has taken
auto is_alive = [&]() -> bool { return node != NONE || leaf.y != 0u; };
for (;;) {
    if (REFILL > 0) {
        const unsigned idle = ballot(!is_alive());
        const int wanted = SINGLE_LANE ? 1 : bit_count(idle);
        if (idle == ALL_LANES || (more && wanted >= REFILL)) {
            if (!is_alive() && slot >= 0) finish();
            if (!more) break;
            int first = 0;
#if defined(__CUDA_ARCH__)
            if (lanes_below() == 0u) first = atomicAdd(cursor.data, wanted);
            first = __shfl_sync(ALL_LANES, first, 0);
#else
            first = cursor.data[0];
            cursor.data[0] += wanted;
#endif
            const int mine = first + bit_count(idle & lanes_below());
            if (!is_alive() && mine < (SINGLE_LANE && thread != 0 ? 0 : ray_count)) take(mine);
            more = first + wanted < ray_count;
        }
    } else if (!is_alive()) {
        if (slot >= 0) {
            finish();
            break;
        }
        if (thread >= ray_count) break;
        take(thread);
    }
#if COUNTERS
    count_lanes(0, is_alive());
#endif
    if (TWO_LEVEL && is_alive()) {
        if (in_top_level() && leaf.y) enter();
        renew_ray();
    }
    const bool in_mesh = !TWO_LEVEL || !in_top_level();
    if (node != NONE && may_visit(in_mesh)) visit();
#if EVERY_TRIANGLE
    while (in_mesh && leaf.y) test();
#else
    if (in_mesh && leaf.y) test();
#endif
    if (node == NONE) choose();
}
#if COUNTERS
report_lanes();
#endif
