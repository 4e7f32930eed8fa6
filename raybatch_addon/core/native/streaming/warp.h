// The lanes of a warp, and what threads have in common: on CUDA 32 threads are a warp, on a CPU each thread is one.
//
// What a warp writes before `fence` others see who find a value that it published behind that, and who call `fence`
// themselves.

#if defined(__CUDA_ARCH__)
constexpr int LANES = 32;
auto add = [](int* p, int n) -> int { return atomicAdd(p, n); };
auto publish = [](int* p, int value) { atomicExch(p, value); };
auto look = [](const int* p) -> int { return *(const volatile int*)p; };
auto publish_entry = [](long long* p, long long value) {
    atomicExch((unsigned long long*)p, (unsigned long long)value);
};
auto look_at_entry = [](const long long* p) -> long long { return *(const volatile long long*)p; };
auto fence = []() { __threadfence(); };
auto together = []() { __syncwarp(); };
auto of_lane = [](int value, int lane) -> int { return __shfl_sync(0xffffffffu, value, lane); };
auto of_other = [](int value, int distance) -> int { return __shfl_xor_sync(0xffffffffu, value, distance); };
auto rest = []() { __nanosleep(200); };
#else
constexpr int LANES = 1;
auto add = [](int* p, int n) -> int { return __atomic_fetch_add(p, n, __ATOMIC_SEQ_CST); };
auto publish = [](int* p, int value) { __atomic_store_n(p, value, __ATOMIC_SEQ_CST); };
auto look = [](const int* p) -> int { return __atomic_load_n(p, __ATOMIC_SEQ_CST); };
auto publish_entry = [](long long* p, long long value) { __atomic_store_n(p, value, __ATOMIC_SEQ_CST); };
auto look_at_entry = [](const long long* p) -> long long { return __atomic_load_n(p, __ATOMIC_SEQ_CST); };
auto fence = []() { __atomic_thread_fence(__ATOMIC_SEQ_CST); };
auto together = []() {};
auto of_lane = [](int value, int) -> int { return value; };
auto of_other = [](int value, int) -> int { return value; };
auto rest = []() {};
#endif
const int lane = thread % LANES, number = thread / LANES;
int* const counters = queues.counters.data;
int* const own = queues.warps.data + WARP_WORDS * number;
int* const tokens = queues.tokens.data + (long long)queues.batch * number;
// An entry of a ring holds a token, and above it whose turn it is: that of a ticket, whose token it gets; the number
// behind the ticket, while the token is there
auto entry = [&](int queue, int ticket) -> long long* {
    return (long long*)queues.ring.data + queues.first.data[queue] + (ticket & queues.mask.data[queue]);
};
auto entry_of = [](unsigned turn, int token) -> long long { return (long long)turn << 32 | (unsigned)token; };
// Waits for the turn, which others are about to give; what the entry is then. -1, and a fault: it does not come
auto wait_for = [&](const long long* p, unsigned turn, int queue) -> long long {
    for (int tries = 0; tries < TRIES_MOST; ++tries) {
        const long long found = look_at_entry(p);
        if ((unsigned)(found >> 32) == turn) return found;
        if (tries % 1024 == 1023 && look(counters + FAULT) != 0) return -1;  // that of another warp
        rest();
    }
    publish(counters + FAULT, 1 + queue);
    return -1;
};
