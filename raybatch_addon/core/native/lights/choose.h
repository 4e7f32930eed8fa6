// An emitter that is alone is always chosen: 1.0f as a word.
if (table.emitter_count == 1) return wp::vec2i(0, 0x3f800000);
// What is left of the random number: a whole number below DRAWS.
int draw = static_cast<int>(bits >> 8u);
wp::uint32 state = seed;
float probability = 1.0f;
// the part [first, first + width) that it lies in, stretched to all; a hash fills up the digits that are missing
auto take = [&](int first, int width) {
    state = state * 747796405u + 2891336453u;
    const wp::uint32 word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    const float part = (static_cast<float>(draw - first) + static_cast<float>(word >> 8u) * UNIT) /
                       static_cast<float>(width) * static_cast<float>(DRAWS);
    draw = wp::min(static_cast<int>(part), DRAWS - 1);
    probability *= static_cast<float>(width) * UNIT;
};
auto choose_one = [&](const Shares& shares) {
    int chosen = 0;  // as many as end before the number or at it
#if defined(__CUDA_ARCH__)
    while (draw >= shares.begin[chosen + 1]) ++chosen;
#else
    typedef int Ends __attribute__((ext_vector_type(WIDTH)));
    typedef bool Flags __attribute__((ext_vector_type(WIDTH)));
    Ends ends;
    __builtin_memcpy(&ends, shares.begin + 1, sizeof(ends));
    const Flags are_before = __builtin_convertvector(ends <= draw, Flags);
    unsigned short bits_before;
    static_assert(sizeof(are_before) == sizeof(bits_before), "a bit for each of WIDTH");
    __builtin_memcpy(&bits_before, &are_before, sizeof(bits_before));
    chosen = __builtin_popcount(bits_before);
#endif
    take(shares.begin[chosen], shares.width(chosen));
    return chosen;
};

int emitter = -1, block = 0;
while (block >= 0) {
#if !defined(__CUDA_ARCH__)
    // else what lies below is waited for after all that is compared
    __builtin_prefetch(choice_table.below.data + block * WIDTH);
#endif
    const Shares shares = shares_in(block);
    if (shares.begin[WIDTH + 1] == 0) break;  // nothing shines
    const int chosen = choose_one(shares);
#if SUNS || WORLD
    if (chosen == WIDTH) {
        const float scale = scale_of(all_distant(), choice_table.distant_count);
        int before = 0, draws = DRAWS, taken = 0;  // the first has what the others leave
        for (int number = 1; number < choice_table.distant_count; ++number) {
            draws -= draws_of(counted_distant(number), scale);
        }
        for (; draw >= before + draws && taken + 1 < choice_table.distant_count; ++taken) {
            before += draws;
            draws = draws_of(counted_distant(taken + 1), scale);
        }
        take(before, draws);
        emitter = choice_table.distant.data[taken];
        break;
    }
#endif
    block = choice_table.below.data[block * WIDTH + chosen];
    if (block < 0) emitter = -1 - block;
}
if (emitter < 0) probability = 0.0f;
union {
    float number;
    int word;
} stored;
stored.number = probability;
return wp::vec2i(emitter, stored.word);
