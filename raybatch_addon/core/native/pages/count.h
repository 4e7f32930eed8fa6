// The rays of both kinds in the chunk of a warp.
unsigned int first = 0, second = 0;
for (long long base = begin; base < end; base += SLOTS_A_TURN) {
    const int slot = (int)base + 4 * lane;
    const int states[4] = {next.x, next.y, next.z, next.w};
    next = four(base + SLOTS_A_TURN + 4 * lane);
    for (int k = 0; k < 4; ++k) {
        first += is_first(states[k], slot + k) ? 1 : 0;
        second += is_second(states[k], slot + k) ? 1 : 0;
    }
}
unsigned long long both = (unsigned long long)second << 32 | first;
for (int step = 16; step > 0; step /= 2) both += __shfl_xor_sync(0xffffffffu, both, step);
if (lane == 0) waiting.parts.data[warp] = both;
