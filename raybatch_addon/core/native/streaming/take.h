// A warp chooses a queue and takes tokens from it. Returns the queue, the same in all lanes; -1: the launch is over.

constexpr int LEAVE_NOW = -1, NOTHING = -2;
const int queue_count = queues.size.shape[0];
// The queue that the warp has just come to too late: it goes elsewhere first. The latest stages have few tokens, and all
// warps look at the same sizes
int in_vain = NOTHING;
bool is_fair = false;  // the last choice

// How much a warp wants to serve queue `q` next: 0, not at all. A full batch comes before every partial one; of full
// ones that of a later stage, of treelets that of the longest queue, or as `selection` has it; of partial ones the
// longest. In a fair turn the next queue in turn that is not empty comes first.
auto wish = [&](int q, int left, bool fair) -> int {
    if (q == in_vain && !fair) return 0;
    int size = look(queues.size.data + q);
    if (q == GENERATE && size > left) size = left;
    if (size <= 0) return 0;
    const int after = (q - own[LAST] - 1 + queue_count) % queue_count;  // queues between the last one in turn and this
    if (fair) return (1 << 30) - after;
    if (size < (q > TREELETS ? queues.full_treelet : queues.full)) return size;
    // stages by number, but treelets last of all, behind new paths
    const int rank = q < GENERATE ? 15 - q : q == GENERATE ? 2 : 1;
    int amount = size < (1 << 24) ? size : (1 << 24) - 1;
    if (q >= TREELETS && queues.selection == IN_TURN) amount = (1 << 24) - 1 - after;
    if (q >= TREELETS && queues.selection == AT_RANDOM)
        amount =
            (int)(((unsigned)(q + 1) * 2654435761u ^ (unsigned)(own[PICKS] * LANES + number) * 2246822519u) >> 9) + 1;
    return 1 << 29 | rank << 24 | amount;
};
auto choose = [&]() -> int {
    const int left = of_lane(queues.limit - look(counters + BEGUN), 0);
    if (left <= 0) fence();  // those that began the last ones are alive for who sees this
    const int alive = of_lane(look(counters + ALIVE), 0);
    const bool over =
        look(counters + LEAVE) != 0 || look(counters + FAULT) != 0 || look(counters + WORK) >= queues.budget;
    if (of_lane(over || (left <= 0 && alive == 0), 0)) return LEAVE_NOW;
    const bool fair = own[PICKS] % FAIR_TURNS == FAIR_TURNS - 1;
    int best = 0, chosen = NOTHING;
    for (int q = lane; q < queue_count; q += LANES) {
        const int w = wish(q, left, fair);
        if (w > best) {
            best = w;
            chosen = q;
        }
    }
    for (int distance = LANES / 2; distance > 0; distance /= 2) {
        const int other = of_other(best, distance), its = of_other(chosen, distance);
        if (other > best || (other == best && its > chosen)) {
            best = other;
            chosen = its;
        }
    }
    chosen = of_lane(chosen, 0);
    together();
    if (lane == 0 && chosen >= 0) own[PICKS] = own[PICKS] < (1 << 30) ? own[PICKS] + 1 : 0;
    is_fair = fair;
    together();
    return chosen;
};
// Tokens that the warp may take, which is then the only one that may: their number; `head` is the first one's ticket.
// It subtracts what it sees from `size`, at most a batch, and adds again what was not there any more, so that warps at
// one queue do not wait for each other; until then others see less than there is
auto claim = [&](int q, int& head) -> int {
    const int seen = look(queues.size.data + q);
    const int wanted = seen < queues.batch ? seen : queues.batch;
    if (wanted <= 0) return 0;
    const int size = add(queues.size.data + q, -wanted);
    const int n = size < 0 ? 0 : size < wanted ? size : wanted;
    if (n < wanted) add(queues.size.data + q, wanted - n);
    if (n == 0) return 0;
    if (q > TREELETS) add(queues.room.data + q - TREELETS - 1, n);
    head = add(queues.head.data + q, n);
    return n;
};

int queue, count = 0, head = 0;
together();
for (int idle = 0;;) {
    queue = choose();
    if (queue == NOTHING && ++idle > IDLE_MOST) queue = LEAVE_NOW;
    if (queue == LEAVE_NOW) break;
    if (queue == NOTHING) {
        in_vain = NOTHING;
        rest();
        continue;
    }
    if (lane == 0) count = claim(queue, head);
    count = of_lane(count, 0);
    head = of_lane(head, 0);
    if (count > 0) break;
    in_vain = queue;
    rest();
}
if (queue == LEAVE_NOW) return LEAVE_NOW;
// Who puts with the same ticket was given it before, and is about to write the entry
for (int i = lane; i < count; i += LANES) {
    const int ticket = head + i;
    long long* const p = entry(queue, ticket);
    const long long found = wait_for(p, (unsigned)ticket + 1u, queue);
    if (found == -1) break;
    tokens[i] = (int)found;
    publish_entry(p, entry_of((unsigned)ticket + (unsigned)queues.mask.data[queue] + 1u, 0));
}
together();
if (of_lane(look(counters + FAULT), 0) != 0) return LEAVE_NOW;
if (lane == 0) {
    own[HELD] = count;
    own[FROM] = queue;
    own[CURSOR] = 0;
    if (is_fair) own[LAST] = queue;
    add(counters + WORK, count);
    if (queue == GENERATE) {
        // alive before they are begun: no other warp sees that all are begun and none is alive
        add(counters + ALIVE, count);
        fence();
        const int first = add(counters + BEGUN, count), left = queues.limit - first;
        own[ITEM] = first;
        own[BEGINS] = left < 0 ? 0 : left < count ? left : count;
        if (own[BEGINS] < count) add(counters + ALIVE, own[BEGINS] - count);
    }
}
fence();
together();
return queue;
