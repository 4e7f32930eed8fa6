// Estimates of the light that comes to `point`: from below a node of the tree over emitters, and from each of those that
// are compared one by one. 0: surely none.
const auto& choice_table = *table.choice.data;

// cos(max(a - b, 0)) of angles within [0, pi]
auto cosine_beyond = [](float cos_a, float cos_b) {
    if (cos_a >= cos_b) return 1.0f;
    return cos_a * cos_b + wp::sqrt(wp::max((1.0f - cos_a * cos_a) * (1.0f - cos_b * cos_b), 0.0f));
};
auto within = [](float x, float least, float most) { return wp::min(wp::max(x, least), most); };

#if LOCAL
#if defined(__CUDA_ARCH__)
struct alignas(16) Quarter {
    float x, y, z, w;
};
#endif
using Node = typename wp::remove_reference<decltype(choice_table.nodes.data[0])>::type;
// On a GPU threads go down the tree apart, and each load of one takes as long as that of all: few wide ones.
auto load_node = [&](int at) -> Node {
#if defined(__CUDA_ARCH__)
    static_assert(sizeof(Node) == 3 * sizeof(Quarter), "LightNode is loaded by quarters of 64 bytes");
    union Parts {
        Quarter quarters[3];
        Node node;
        __device__ Parts() {}
    } parts;
    const Quarter* from = reinterpret_cast<const Quarter*>(choice_table.nodes.data + at);
    for (int i = 0; i < 3; ++i) parts.quarters[i] = from[i];
    return parts.node;
#else
    return choice_table.nodes.data[at];
#endif
};
auto node_light = [&](const Node& node) -> float {
    if (!(node.power > 0.0f)) return 0.0f;
    const wp::vec3 to = node.centre - point.position;
    const float square = wp::dot(to, to), reach = node.radius * node.radius;
    float turned = 1.0f;
    if (square > reach && square > 1e-30f && square < 1e37f) {  // else its root has lost its digits
        const float inverse = 1.0f / wp::sqrt(square);
        // of the angle under which the node's sphere is seen
        const float sine = wp::min(node.radius * inverse, 1.0f);
        const float cosine = wp::sqrt(1.0f - sine * sine);
        if (node.cos_axis > -1.0f) {
            float leaving = -wp::dot(node.axis, to) * inverse;
            if (node.two_sided) leaving = wp::abs(leaving);
            leaving = cosine_beyond(cosine_beyond(within(leaving, -1.0f, 1.0f), node.cos_axis), cosine);
            if (leaving < node.cos_edge - COSINE_ERROR) return 0.0f;
            turned = wp::max(leaving, COSINE_MIN);
        }
        float arriving = wp::dot(point.normal, to) * inverse;
        if (point.both_sides) arriving = wp::abs(arriving);
        turned *= wp::max(cosine_beyond(within(arriving, -1.0f, 1.0f), cosine), COSINE_MIN);
    }
    return within(node.power * turned / wp::max(square, reach), LEAST, MOST);
};
#endif

#if SUNS
auto sun_light = [&](int emitter, float strength) -> float {
    float cosine = -wp::dot(table.lights.data[emitter].axis, point.normal);
    if (point.both_sides) cosine = wp::abs(cosine);
    return within(strength * wp::max(cosine, COSINE_MIN), LEAST, MOST);
};
#endif

#if WORLD
// irradiance by spherical harmonics (Ramamoorthi and Hanrahan 2001)
auto world_light = [&]() -> float {
    const float* e = choice_table.world_irradiance.data;
    const float x = point.normal[0], y = point.normal[1], z = point.normal[2];
    const float even =
        e[0] + e[4] * x * y + e[5] * y * z + e[6] * (3.0f * z * z - 1.0f) + e[7] * x * z + e[8] * (x * x - y * y);
    const float odd = e[1] * y + e[2] * z + e[3] * x;
    return within(wp::max(even + (point.both_sides ? wp::abs(odd) : odd), COSINE_MIN * e[0]), LEAST, MOST);
};
#endif

// of the candidates: the first nodes, then suns and the world
auto candidate_light = [&](int candidate) -> float {
#if LOCAL
    if (candidate < choice_table.root_count) return node_light(load_node(candidate));
#endif
#if SUNS || WORLD
    const int distant = candidate - choice_table.root_count;
#endif
#if SUNS
    const int emitter = choice_table.distant.data[distant];
    if (emitter < table.light_count) return sun_light(emitter, choice_table.distant_strength.data[distant]);
#endif
#if WORLD
    return world_light();
#else
    return 0.0f;
#endif
};
const int candidate_count = choice_table.root_count + choice_table.distant_count;

// the probability of what counts `value` of `total`: one that a draw of 24 bits meets exactly
auto share_of = [&](float value, float total) {
    return within(wp::ceil(value / total * (1.0f / UNIT)) * UNIT, UNIT, 1.0f - UNIT);
};
