// The lists, written to `slots`, and their lengths.
const int blocks = (offsets.shape[0] - 1) / LISTS;
#if defined(__CUDA_ARCH__)
auto start = [&](int k, int block) { return offsets.data[k * blocks + block]; };
#else
int starts[LISTS + 1] = {};
if (blocks == 1) {
    count(starts + 1);
    for (int k = 0; k < LISTS; ++k) starts[k + 1] += starts[k];
}
auto start = [&](int k, int block) { return blocks == 1 ? starts[k] : offsets.data[k * blocks + block]; };
#endif
int at[LISTS];
for (int k = 0; k < LISTS; ++k) at[k] = start(k, block_number);
// Differences of the two sets; rays that are listed count as under way from now on
#if TURN
auto write_lengths = [&]() {
    for (int k = 0; k < LISTS; ++k) lengths.data[LENGTH_DONE + k] = start(k + 1, 0) - start(k, 0);
    lengths.data[LENGTH_BOUNCE] = start(LENGTH_SHADOW, 0) - start(LENGTH_BOUNCE_1, 0);
};
auto place_apart = []() {};
auto slot_of = [&](int path, int k) { return k == LENGTH_SHADOW ? paths + path : path; };
auto submit = [&](int path, unsigned int lists) {
    const int flipped =
        (lists & (IN_1 | IN_2 | IN_LATER) ? RAY_NEW | RAY_OUT : 0) | (lists & IN_SHADOW ? SHADOW_NEW | SHADOW_OUT : 0);
    if (flipped) status.data[path] ^= flipped;
};
#else
auto write_lengths = [&]() {
    for (int k = 0; k < LISTS; ++k) lengths.data[LENGTH_MISS + k] = start(k + 1, 0) - start(k, 0);
};
auto place_apart = [&]() { at[1] += paths - start(1, 0); };
auto slot_of = [](int path, int) { return path; };
auto submit = [](int, unsigned int) {};
#endif
if (block_number == 0 && lane == 0) write_lengths();
place_apart();
#if defined(__CUDA_ARCH__)
for (int from = first; from < end; from += 32) {
    const int path = from + lane;
    const unsigned int lists = path < end ? lists_of(status.data[path]) : 0u;
    for (int k = 0; k < LISTS; ++k) {
        const unsigned int vote = __ballot_sync(0xffffffffu, lists >> k & 1u);
        if (lists >> k & 1u) slots.data[at[k] + __popc(vote & ((1u << lane) - 1u))] = slot_of(path, k);
        at[k] += __popc(vote);
    }
    if (lists) submit(path, lists);
}
#else
over_chunks([&](int from, int n, const unsigned int* lists, const unsigned int* masks) {
    for (int k = 0; k < LISTS; ++k)
        if (masks[k] == ALL) {
            for (int i = 0; i < CHUNK; ++i) slots.data[at[k] + i] = slot_of(from + i, k);
            at[k] += CHUNK;
        } else
            for (unsigned int rest = masks[k]; rest; rest &= rest - 1u)
                slots.data[at[k]++] = slot_of(from + __builtin_ctz(rest), k);
    for (int i = 0; i < n; ++i) submit(from + i, lists[i]);
});
#endif
