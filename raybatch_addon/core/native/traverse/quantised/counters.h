// What a lane counts.

#if COUNTERS
int visits = 0, boxes = 0, tests = 0, entered = 0;
unsigned lanes_busy[3] = {0u, 0u, 0u}, lanes_there[3] = {0u, 0u, 0u};
// every lane that comes here is busy; one of them counts all lanes of the warp
auto count_lanes = [&](int what, bool busy) {
#if defined(__CUDA_ARCH__)
    const unsigned together = __activemask();
    lanes_there[what] += (together & lanes_below()) == 0u ? 32u : 0u;
#else
    lanes_there[what] += 1u;
#endif
    lanes_busy[what] += busy ? 1u : 0u;
};
auto count_node = [&](const Words& b) {
    count_lanes(1, true);
    ++visits;
    boxes += bit_count((b.z >> 5) & 0x01010101u) + bit_count((b.w >> 5) & 0x01010101u);
};
auto report_lanes = [&]() {
    for (int k = 0; k < 3; ++k) {
#if defined(__CUDA_ARCH__)
        atomicAdd((unsigned long long*)counts.lanes.data + 2 * k, (unsigned long long)lanes_busy[k]);
        atomicAdd((unsigned long long*)counts.lanes.data + 2 * k + 1, (unsigned long long)lanes_there[k]);
#else
        counts.lanes.data[2 * k] += lanes_busy[k];
        counts.lanes.data[2 * k + 1] += lanes_there[k];
#endif
    }
};
#endif
