// The rays that are taken, in the order of their slots: on CUDA those of a warp's chunk, on the CPU all.
#if defined(__CUDA_ARCH__)
const unsigned int before = (1u << lane) - 1;
const int first = taken.count.data[1], second = taken.count.data[2];
int rank_first = (int)(unsigned int)waiting.parts.data[warp], rank_second = (int)(waiting.parts.data[warp] >> 32);
for (long long base = begin; base < end; base += SLOTS_A_TURN) {
    const int slot = (int)base + 4 * lane;
    const int states[4] = {next.x, next.y, next.z, next.w};
    next = four(base + SLOTS_A_TURN + 4 * lane);
    // those of lanes before this one, then its own in order
    int rank_a = rank_first, rank_b = rank_second;
    for (int k = 0; k < 4; ++k) {
        const unsigned int all_a = __ballot_sync(0xffffffffu, is_first(states[k], slot + k));
        const unsigned int all_b = __ballot_sync(0xffffffffu, is_second(states[k], slot + k));
        rank_a += __popc(all_a & before);
        rank_b += __popc(all_b & before);
        rank_first += __popc(all_a);
        rank_second += __popc(all_b);
    }
    for (int k = 0; k < 4; ++k) {
        if (is_first(states[k], slot + k)) {
            if (rank_a < first) write_ray(rank_a, slot + k, states[k]);
            ++rank_a;
        } else if (is_second(states[k], slot + k)) {
            if (rank_b < second) write_ray(first + rank_b, slot + k, states[k]);
            ++rank_b;
        }
    }
}
#else
const int n = waiting.location.shape[0], capacity = taken.slots.shape[0];
int first = 0, second = 0;
for (int i = 0; i < n && first < capacity; ++i) {
    const int state = waiting.location.data[i];
    if (is_first(state, i)) write_ray(first++, i, state);
}
const int most = second_most < capacity - first ? second_most : capacity - first;
for (int i = 0; i < n && second < most; ++i) {
    const int state = waiting.location.data[i];
    if (is_second(state, i)) write_ray(first + second++, i, state);
}
write_counts(first, second);
#endif
