// The probability with which `choose.h` finds `emitter`.
if (table.emitter_count == 1) return 1.0f;
const int leaf = choice_table.leaf.data[emitter];
int block = leaf < 0 ? 0 : leaf / WIDTH, place = leaf < 0 ? WIDTH : leaf % WIDTH;
float probability = 1.0f;
while (probability > 0.0f) {
    probability *= static_cast<float>(shares_in(block).width(place)) * UNIT;
    const int above = choice_table.above.data[block];
    if (above < 0) break;
    block = above / WIDTH;
    place = above % WIDTH;
}
#if SUNS || WORLD
if (leaf < 0) {
    const float scale = scale_of(all_distant(), choice_table.distant_count);
    int own = 0, others = 0;
    for (int number = 0; number < choice_table.distant_count; ++number) {
        const int draws = draws_of(counted_distant(number), scale);
        (choice_table.distant.data[number] == emitter ? own : others) += draws;
    }
    if (choice_table.distant.data[0] == emitter) own = DRAWS - others;
    probability *= static_cast<float>(own) * UNIT;
}
#endif
return probability;
