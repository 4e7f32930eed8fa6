// The probability with which `choose.h` finds `emitter`.
int wanted = -1;
float below = 1.0f;
#if LOCAL
int at = choice_table.leaf.data[emitter];
while (at >= ROOTS_MOST) {
    const int pair = at >> 1;
    const float light = node_light(load_node(2 * pair)), other = node_light(load_node(2 * pair + 1));
    const bool is_first = (at & 1) == 0;
    if ((is_first ? light : other) <= 0.0f) return 0.0f;
    if (light > 0.0f && other > 0.0f) {
        const float share = share_of(light, light + other);
        below *= is_first ? share : 1.0f - share;
    }
    at = choice_table.parent.data[pair];
}
wanted = at;
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
