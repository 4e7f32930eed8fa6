// The paths of a block, and which lists each belongs to: TURN, the lists at the end of a turn; otherwise those when
// rays are back. The LISTS of either are numbered as `Length` orders them. A thread of a CPU or a warp of CUDA takes a
// block.
const int paths = status.shape[0];
#if defined(__CUDA_ARCH__)
const int block_number = thread / 32, lane = thread % 32;
#else
const int block_number = thread, lane = 0;
#endif
const int first = block_number * block_size, end = paths - first > block_size ? first + block_size : paths;

constexpr int WAITING = RAY_NEW | RAY_OUT | SHADOW_NEW | SHADOW_OUT;
// `lists_of`: which lists a path belongs to, as bits, from its status
#if TURN
constexpr unsigned int IN_DONE = 1u << LENGTH_DONE, IN_FREE = 1u << LENGTH_FREE, IN_SHADOW = 1u << LENGTH_SHADOW;
constexpr unsigned int IN_1 = 1u << LENGTH_BOUNCE_1, IN_2 = 1u << LENGTH_BOUNCE_2, IN_LATER = 1u << LENGTH_BOUNCE_LATER;
const unsigned int free = with_free ? IN_FREE : 0u;
const unsigned int second = by_bounce ? IN_2 : IN_1, later = by_bounce ? IN_LATER : IN_1;
auto lists_of = [&](int word) -> unsigned int {
    const int bounce = word >> BOUNCE_SHIFT;
    const unsigned int extending = word & INSIDE ? later : bounce <= 1 ? IN_1 : bounce == 2 ? second : later;
    const unsigned int rays = (word & RAY_NEW ? extending : 0u) | (word & SHADOW_NEW ? IN_SHADOW : 0u);
    const unsigned int alive = (word & (ENDED | WAITING)) == ENDED ? IN_DONE : rays;
    return word & ALIVE ? alive : free;
};
#else
constexpr unsigned int IN_MISS = 1u, IN_SURFACE = 1u << (LENGTH_SURFACE - LENGTH_MISS);
auto lists_of = [&](int word) -> unsigned int {
    const unsigned int back = word & HIT ? IN_SURFACE : IN_MISS;
    return (word & (ALIVE | ENDED | WAITING)) == ALIVE ? back : 0u;
};
#endif

// On the CPU `over_chunks(visit)` calls `visit(from, n, lists, masks)` for the paths of the block, CHUNK at a time and
// in their order, unless none of these is in a list: `lists` is what each path belongs to, and masks[k] which of them
// belong to list k. It is written for vector units.
#if !defined(__CUDA_ARCH__)
constexpr int CHUNK = 16;
constexpr unsigned int ALL = (1u << CHUNK) - 1u;
auto over_chunks = [&](auto&& visit) {
    for (int from = first; from < end; from += CHUNK) {
        const int n = end - from > CHUNK ? CHUNK : end - from;
        int words[CHUNK] = {}, any = 0;
        if (n == CHUNK)
            for (int i = 0; i < CHUNK; ++i) words[i] = status.data[from + i];
        else
            for (int i = 0; i < n; ++i) words[i] = status.data[from + i];
        for (int i = 0; i < CHUNK; ++i) any |= words[i];
        if (!(any & ALIVE) && !lists_of(0)) continue;
        unsigned int lists[CHUNK], masks[LISTS];
        for (int i = 0; i < CHUNK; ++i) lists[i] = lists_of(words[i]);
        for (int k = 0; k < LISTS; ++k) {
            masks[k] = 0u;
            for (int i = 0; i < CHUNK; ++i) masks[k] |= (lists[i] >> k & 1u) << i;
            masks[k] &= ALL >> (CHUNK - n);
        }
        visit(from, n, lists, masks);
    }
};
auto count = [&](int* found) {
    over_chunks([&](int, int, const unsigned int*, const unsigned int* masks) {
        for (int k = 0; k < LISTS; ++k) found[k] += __builtin_popcount(masks[k]);
    });
};
#endif
