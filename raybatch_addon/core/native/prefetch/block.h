// Asks for `bytes` of memory from `address` on, every `stride`-th cache line from `first` on: on CUDA into the L2 cache,
// on a CPU into all of its core's.
#if defined(__CUDA_ARCH__)
constexpr unsigned long long CACHE_LINE = 128ull;
#else
constexpr unsigned long long CACHE_LINE = 64ull;
#endif
for (unsigned long long at = CACHE_LINE * first; at < (unsigned long long)bytes; at += CACHE_LINE * stride) {
#if defined(__CUDA_ARCH__)
    asm volatile("prefetch.global.L2 [%0];" ::"l"(address + at));
#else
    __builtin_prefetch((const char*)(address + at));
#endif
}
