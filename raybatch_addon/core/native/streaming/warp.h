// The lanes of a warp, and what threads have in common: on CUDA 32 threads are a warp, on a CPU each thread is one.
//
// What a warp writes before `fence` others see who find a value that it published behind that, and who call `fence`
// themselves.

#if defined(__CUDA_ARCH__)
constexpr int LANES = 32;
auto add = [](int* p, int n) -> int { return atomicAdd(p, n); };
auto swap_if = [](int* p, int before, int after) -> int { return atomicCAS(p, before, after); };
auto publish = [](int* p, int value) { atomicExch(p, value); };
auto look = [](const int* p) -> int { return *(const volatile int*)p; };
auto fence = []() { __threadfence(); };
auto together = []() { __syncwarp(); };
auto of_lane = [](int value, int lane) -> int { return __shfl_sync(0xffffffffu, value, lane); };
auto of_other = [](int value, int distance) -> int { return __shfl_xor_sync(0xffffffffu, value, distance); };
auto rest = []() { __nanosleep(200); };
#else
constexpr int LANES = 1;
auto add = [](int* p, int n) -> int { return __atomic_fetch_add(p, n, __ATOMIC_SEQ_CST); };
auto swap_if = [](int* p, int before, int after) -> int {
    __atomic_compare_exchange_n(p, &before, after, false, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST);
    return before;
};
auto publish = [](int* p, int value) { __atomic_store_n(p, value, __ATOMIC_SEQ_CST); };
auto look = [](const int* p) -> int { return __atomic_load_n(p, __ATOMIC_SEQ_CST); };
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
auto entry = [&](int queue, int ticket) -> int* {
    return queues.ring.data + queues.first.data[queue] + (unsigned)(ticket & queues.mask.data[queue]);
};
