// What is written about rays that are taken.
// `write_counts` is called once, when it is known how many are taken; `write_ray` for each of them.
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
    else waiting.location.data[slot] = IDLE;
};
