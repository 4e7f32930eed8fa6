// What is left of the random number: [0, 1), in steps of UNIT, which shares are made of too, so that each is met exactly.
float left = static_cast<float>(bits >> 8u) * UNIT;
wp::uint32 state = seed;
// the part [first, first + width) that it lies in, stretched to [0, 1); a hash fills up the digits that are missing
auto stretch = [&](float first, float width) {
    state = state * 747796405u + 2891336453u;
    const wp::uint32 word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    const float inverse = 1.0f / width;
    left = (left - first) * inverse + UNIT * inverse * (static_cast<float>(word >> 8u) * UNIT);
    left = wp::min(wp::floor(left * (1.0f / UNIT)) * UNIT, 1.0f - UNIT);
};

// each candidate takes the place of the one before with its share of the light so far
float total = 0.0f, probability = 0.0f;
int chosen = -1;
for (int candidate = 0; candidate < candidate_count; ++candidate) {
    const float light = candidate_light(candidate);
    if (!(light > 0.0f)) continue;
    total += light;
    if (chosen < 0) {
        chosen = candidate;
        probability = 1.0f;
        continue;
    }
    const float share = share_of(light, total);
    if (left < share) {
        chosen = candidate;
        probability = share;
        stretch(0.0f, share);
    } else {
        probability *= 1.0f - share;
        stretch(share, 1.0f - share);
    }
}

int emitter = -1;
if (chosen >= choice_table.root_count) {
    emitter = choice_table.distant.data[chosen - choice_table.root_count];
}
#if LOCAL
else if (chosen >= 0) {
    int at = choice_table.roots.data[chosen];
    for (int first = choice_table.nodes.data[at].first; first >= 0; first = choice_table.nodes.data[at].first) {
        const int second = choice_table.nodes.data[at].second;
        const float light = node_light(choice_table.nodes.data[first]);
        const float other = node_light(choice_table.nodes.data[second]);
        if (light + other <= 0.0f) {
            at = -1;
            probability = 0.0f;
            break;
        }
        if (light <= 0.0f || other <= 0.0f) {
            at = light > 0.0f ? first : second;
            continue;
        }
        const float share = share_of(light, light + other);
        if (left < share) {
            at = first;
            probability *= share;
            stretch(0.0f, share);
        } else {
            at = second;
            probability *= 1.0f - share;
            stretch(share, 1.0f - share);
        }
    }
    if (at >= 0) emitter = choice_table.nodes.data[at].emitter;
}
#endif
union {
    float number;
    int word;
} stored;
stored.number = probability;
return wp::vec2i(emitter, stored.word);
