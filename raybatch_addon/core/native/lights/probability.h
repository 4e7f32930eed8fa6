// The probability with which `choose.h` finds `emitter`.
float probability = 1.0f;
int at = -1;
#if LOCAL
at = choice_table.leaf.data[emitter];
while (at >= choice_table.root_count && probability > 0.0f) {
    const int parent = choice_table.parent.data[at], first = choice_table.nodes.data[parent].below;
    const Block block = block_of(first, choice_table.nodes.data[parent].count, false);
    probability *= static_cast<float>(block.draws[at - first]) * UNIT;
    at = parent;
}
#endif
const Block top = block_of(0, choice_table.root_count, true);
if (at >= 0) return probability * (static_cast<float>(top.draws[at]) * UNIT);
#if SUNS || WORLD
const float scale = scale_of(all_distant(), choice_table.distant_count);
int own = 0, others = 0;
for (int number = 0; number < choice_table.distant_count; ++number) {
    const int draws = draws_of(distant_light(number), scale);
    (choice_table.distant.data[number] == emitter ? own : others) += draws;
}
if (choice_table.distant.data[0] == emitter) own = DRAWS - others;
probability = static_cast<float>(top.draws[WIDTH]) * UNIT * (static_cast<float>(own) * UNIT);
#endif
return probability;
