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

// whether the draw lies in the first `share` of [0, 1); what is left is stretched
auto take = [&](float share) {
    const bool taken = left < share;
    stretch(taken ? 0.0f : share, taken ? share : 1.0f - share);
    return taken;
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
    const bool taken = take(share);
    if (taken) chosen = candidate;
    probability = taken ? share : probability * (1.0f - share);
}

int emitter = -1;
if (chosen >= choice_table.root_count) {
    emitter = choice_table.distant.data[chosen - choice_table.root_count];
}
#if LOCAL
else if (chosen >= 0) {
    int below = choice_table.nodes.data[chosen].below;
    while (below >= 0) {
        const Node first = load_node(below), second = load_node(below + 1);
        const float light = node_light(first), other = node_light(second);
        if (light + other <= 0.0f) break;  // nothing below shines
        bool goes_first = light > 0.0f;
        if (light > 0.0f && other > 0.0f) {
            const float share = share_of(light, light + other);
            goes_first = take(share);
            probability *= goes_first ? share : 1.0f - share;
        }
        below = goes_first ? first.below : second.below;
    }
    emitter = -1 - below;
    if (below >= 0) {
        emitter = -1;
        probability = 0.0f;
    }
}
#endif
union {
    float number;
    int word;
} stored;
stored.number = probability;
return wp::vec2i(emitter, stored.word);
