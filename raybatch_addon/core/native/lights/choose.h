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
auto choose_one = [&](const Block& block) {
    int before = 0, chosen = block.first;
    for (int k = 0; k <= WIDTH; ++k) {
        if (draw >= before && draw < before + block.draws[k]) {
            chosen = k;
            break;
        }
        before += block.draws[k];
    }
    take(before, block.draws[chosen]);
    return chosen;
};

int emitter = -1;
const Block top = block_of(0, choice_table.root_count, true);
if (top.first <= WIDTH) {
    const int chosen = choose_one(top);
#if SUNS || WORLD
    if (chosen == WIDTH) {
        const float scale = scale_of(all_distant(), choice_table.distant_count);
        int before = 0, draws = DRAWS, taken = 0;
        for (int number = 1; number < choice_table.distant_count; ++number) {
            draws -= draws_of(distant_light(number), scale);
        }
        for (; draw >= before + draws && taken + 1 < choice_table.distant_count; ++taken) {
            before += draws;
            draws = draws_of(distant_light(taken + 1), scale);
        }
        take(before, draws);
        emitter = choice_table.distant.data[taken];
    }
#endif
#if LOCAL
    if (chosen < WIDTH) {
        int at = chosen, below = choice_table.nodes.data[at].below;
        while (below >= 0) {
            const Block block = block_of(below, choice_table.nodes.data[at].count, false);
            if (block.first > WIDTH) break;  // nothing below shines
            at = below + choose_one(block);
            below = choice_table.nodes.data[at].below;
        }
        emitter = below < 0 ? -1 - below : -1;
    }
#endif
}
if (emitter < 0) probability = 0.0f;
union {
    float number;
    int word;
} stored;
stored.number = probability;
return wp::vec2i(emitter, stored.word);
