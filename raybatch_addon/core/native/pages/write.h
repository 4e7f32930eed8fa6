// What is written about rays that are taken.
// once, when it is known how many are taken
auto write_counts = [&](int first, int second) {
    taken.count.data[0] = first + second;
    taken.count.data[1] = first;
    taken.count.data[2] = second;
    if (!READY) {
        waiting.tally.data[CLASS_DONE_CLOSEST] -= first;
        waiting.tally.data[CLASS_DONE_SHADOW] -= second;
        waiting.tally.data[CLASS_IDLE] += first + second;
    }
};
auto write_ray = [&](int rank, int slot, int state) {
    taken.slots.data[rank] = slot;
    if (READY) taken.locations.data[rank] = state;
    else waiting.where.data[slot] = IDLE;
};
