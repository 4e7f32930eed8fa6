// The probability with which `choose.h` finds `emitter`.
int wanted = -1;
float below = 1.0f;
#if LOCAL
int at = choice_table.leaf.data[emitter];
if (at >= 0) {
    for (; choice_table.nodes.data[at].root < 0; at = choice_table.nodes.data[at].parent) {
        const auto& parent = choice_table.nodes.data[choice_table.nodes.data[at].parent];
        const float light = node_light(choice_table.nodes.data[parent.first]);
        const float other = node_light(choice_table.nodes.data[parent.second]);
        const bool is_first = at == parent.first;
        if ((is_first ? light : other) <= 0.0f) return 0.0f;
        if (light > 0.0f && other > 0.0f) {
            const float share = share_of(light, light + other);
            below *= is_first ? share : 1.0f - share;
        }
    }
    wanted = choice_table.nodes.data[at].root;
}
#endif
float total = 0.0f, found = 0.0f;
bool any = false;
for (int candidate = 0; candidate < candidate_count; ++candidate) {
    const float light = candidate_light(candidate);
    if (!(light > 0.0f)) continue;
    bool is_wanted = candidate == wanted;
#if SUNS || WORLD
    if (candidate >= choice_table.root_count)
        is_wanted = choice_table.distant.data[candidate - choice_table.root_count] == emitter;
#endif
    total += light;
    const float share = any ? share_of(light, total) : 1.0f;
    found = is_wanted ? share : found * (1.0f - share);
    any = true;
}
return below * found;
