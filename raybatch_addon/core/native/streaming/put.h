// A warp puts the tokens that it holds into the queues that are their targets.

const int* const targets = queues.targets.data + (long long)queues.batch * number;
// Places for `n` tokens in queue `to`: the ticket of the first. The queues of treelets have few places: what finds none
// waits in one that has places for all
auto reserve = [&](int& to, int n) -> int {
    const int from = own[FROM];
    if (to == GENERATE && from != GENERATE) {
        add(counters + ENDED, n);
        add(counters + ALIVE, -n);
    }
    if (from <= CONNECT || from == GENERATE) {
        if (to == TRACE) add(counters + RAYS, n);
        if (to == SHADOW) add(counters + SHADOW_RAYS, n);
    }
    if (to == SHADOW) to = queues.shadow_queue;
    if (to > TREELETS) {
        int* const room = queues.room.data + to - TREELETS - 1;
        if (add(room, -n) < n) {
            add(room, n);
            to = TREELETS;
        }
    }
    add(queues.size.data + to, n);
    return add(queues.tail.data + to, n);
};
// Who takes what was in the entry before is about to read it
auto place = [&](int to, int ticket, int token) {
    long long* const p = entry(to, ticket);
    if (wait_for(p, (unsigned)ticket, to) == -1) return;
    publish_entry(p, entry_of((unsigned)ticket + 1u, token));
};
together();
fence();
const int count = own[HELD];
#if defined(__CUDA_ARCH__)
for (int base = 0; base < count; base += LANES) {
    const int i = base + lane;
    int to = i < count ? targets[i] : -1, ticket = 0;
    const unsigned group = __match_any_sync(0xffffffffu, to);
    const int leader = __ffs(group) - 1, rank = __popc(group & ((1u << lane) - 1u));
    if (lane == leader && to >= 0) ticket = reserve(to, __popc(group));
    ticket = of_lane(ticket, leader);
    to = of_lane(to, leader);
    if (i < count) place(to, ticket + rank, tokens[i]);
}
#else
for (int i = 0; i < count;) {
    int to = targets[i], n = 1;
    while (i + n < count && targets[i + n] == to) ++n;
    const int ticket = reserve(to, n);
    for (int k = 0; k < n; ++k) place(to, ticket + k, tokens[i++]);
}
#endif
together();
